"""Label propagation: a recording, a map of what its cameras said, and scans labeled from it."""
