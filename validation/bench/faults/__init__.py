"""What a kill or a full disk costs at any moment: `python -m validation.bench faults`."""
