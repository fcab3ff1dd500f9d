"""A run for a person: progress, report, top, trace."""
