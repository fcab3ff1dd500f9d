"""What would run how: `overflight plan`."""
