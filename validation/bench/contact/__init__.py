"""Contact with solids, measured: `python -m validation.bench contact`."""
