"""What a run measures and says of itself: statistics, CPU, traces, reports, expectations."""
