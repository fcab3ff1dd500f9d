"""`overflight run`: where a graph runs, and what is told of it."""
