"""The initial state of masses: initial stress, masses held behind barriers."""
