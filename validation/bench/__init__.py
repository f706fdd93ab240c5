"""Pages of measurements by name: `python -m validation.bench NAME --out docs`."""
