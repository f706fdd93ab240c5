"""What a flow is: its trajectory in memory and on disk, fields and measures of it."""
