"""What datasets consist of: distributions of scenes, by name or from a file."""
