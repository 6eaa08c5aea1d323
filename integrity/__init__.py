"""Where the vehicle is, and how far to trust it: sensing, positioning, monitoring, assessment.

Conventions, declared once and used in every room of this package:

Frames
    ``enu``: local East, North, Up [m]. ``track``: along track AT (forward) and cross track CT (positive to the right).
    ``body``: x forward, y to the right, z down (a yaw rate is positive when the heading turns clockwise).
    ``theta`` / ``heading_rad``: azimuth of motion, clockwise from North [rad].
    ``[AT, CT] = R [E, N]`` with ``R = [[sin t, cos t], [cos t, -sin t]]``, which is its own inverse.
Units
    SI and radians everywhere; degrees only in configuration fields that end in ``_deg``. Names carry unit and frame at
    public boundaries (``pl_at_m``, ``velocity_enu_mps``); kernels use the paper's letters, mapped in their docstrings.
Letters
    ``m`` measurements, ``n`` unknowns, ``G`` (m, n) design matrix, ``Q_y`` (m, m) covariance of the measurements,
    ``W = Q_y^-1``, ``S = (G'WG)^-1 G'W`` (n, m), ``Q(x)`` upper-tail probability of N(0, 1).
    A design row is ``[-e, 1]`` with ``e`` the unit vector from receiver to satellite and the 1 in its clock's column.
Batch rule
    Every kernel takes any leading batch axes. ``B`` counts vehicles, ``S`` satellites, ``K`` sky tables. Satellites out
    of view are masked, never removed.
Outcomes
    Failure is a value: an enumerated verdict, a missing protection level is ``inf``, never NaN.
Randomness
    All draws come from named, seeded streams (:mod:`lanebound.integrity.core.streams`).
Errors
    Bad input raises :class:`~lanebound.integrity.core.errors.InputError` or ``ConfigError``, both ``ValueError``.
"""
