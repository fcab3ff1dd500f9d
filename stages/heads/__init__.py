"""Heads: what the outputs of each kind of detector mean."""
