"""How every page and picture is made: tables, plots, renderings, and the machine that a figure is from."""
