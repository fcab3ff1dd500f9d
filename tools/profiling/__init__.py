"""Where the CPU goes: `overflight profile`."""
