"""What an inversion leaves to read: tables, pictures, curves."""
