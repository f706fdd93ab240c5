"""Robust design: places and heights of barriers that keep runout or impact below a limit with a given probability."""
