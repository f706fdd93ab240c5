"""Forecasts: the posterior of an inversion carried to another flow."""
