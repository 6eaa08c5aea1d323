"""Resumable work: result folders with a manifest, finished parts as files, and worker processes for the missing parts.

An interrupted run loses the parts in progress only. The same command resumes it, and the results are those of an
uninterrupted run.
"""
