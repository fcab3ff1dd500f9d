"""Training of the networks: `overflight train`. The only part of the project that imports torch."""
