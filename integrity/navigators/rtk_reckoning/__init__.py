"""The navigator of S1 figure 1: RTK, bridged by Doppler and by dead reckoning with odometer and gyro."""
