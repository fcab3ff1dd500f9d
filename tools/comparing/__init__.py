"""What a swap of devices changes: `overflight compare`."""
