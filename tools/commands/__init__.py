"""The words of each command: what it takes, and whom it hands them to."""
