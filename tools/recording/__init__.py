"""Recorded flights: written, looked at, replayed and explained."""
