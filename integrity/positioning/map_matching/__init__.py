"""Matching of positions to the links of a road map: maps with errors of their own, and three matchers."""
