"""The kind ``filter``: Kalman filters on vehicle models that fuse GNSS positions, inertial sensors and wheels (S4)."""
