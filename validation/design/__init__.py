"""Robust design: where barriers stand, and how high, so that runout or impact stays below a limit as often as asked."""
