"""Observation operators: what is measured of a flow, and the target that holds it."""
