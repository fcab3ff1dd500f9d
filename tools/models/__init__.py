"""The model registry from the command line: `overflight models`."""
