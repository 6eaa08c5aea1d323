"""Cooperative positioning (S2 sections 2.4 and 7): vehicles and roadside units that share codes, ranges and positions.

=====================  =================================================================================
:mod:`.factors`        what an epoch says of the positions of pairs of nodes
:mod:`.shared_codes`   double differences of shared codes as such factors
:mod:`.joint_filter`   one extended Kalman filter for all vehicles, from codes, Doppler, wheels, gyros and ranges
:mod:`.messages`       SPAWN: sum-product messages between nodes, Gaussian
:mod:`.split`      messages of which each node keeps what may be a rumour apart (split covariance intersection)
:mod:`.particles`      SPAWN, MD-SPAWN and MDPC with particles
:mod:`.exclusion`      which node contradicts the others, and levels that hold until it is found
=====================  =================================================================================

S2 names these algorithms without equations (its [36] to [40]); each module says which source it follows. Nodes are
vehicles and roadside units; the place of a unit is surveyed. Positions are East, North, up [m].
"""
