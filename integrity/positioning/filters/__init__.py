"""Kalman filters on a vehicle model (S4): extended, unscented, and interacting multiple models, for any batch."""
