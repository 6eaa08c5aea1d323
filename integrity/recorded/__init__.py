"""Readers of public data sets: recorded drives and static sessions.

Every reader returns a frozen record of arrays with ``stopped``: None if the file was read to its end, otherwise a
:class:`~lanebound.integrity.recorded.source.Stop` with the place and the reason; the data before this place are
returned. A file with an error before its end, or without usable data, is refused with an ``InputError`` that gives
file, line and field. Times of all series are checked by :mod:`~lanebound.integrity.recorded.source`.
"""
