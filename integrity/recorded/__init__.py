"""Drives and static sessions that others recorded: readers, nothing else.

Every reader returns a frozen record of arrays with ``stopped``: None when the file was read to its end, otherwise a
:class:`~lanebound.integrity.recorded.source.Stop` that says where and why reading ended; what came before is returned.
A file that is wrong elsewhere than at its end, or of which nothing can be used, is refused with an ``InputError`` that
names file, line and field.
"""
