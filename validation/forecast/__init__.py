"""Forecasts: predictions of another flow with the posterior of an inversion."""
