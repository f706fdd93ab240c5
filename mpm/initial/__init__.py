"""The state in which masses begin: initial stress, masses held behind barriers."""
