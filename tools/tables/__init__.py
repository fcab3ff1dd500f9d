"""The paper's experiments with label propagation: its tables 3 to 6, and the same on real data."""
