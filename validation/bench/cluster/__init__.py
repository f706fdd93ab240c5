"""What a scheduler costs beside processes of one machine, and what large work would take."""
