"""Mesh files of several formats, read as plain vertices and faces: one module a format.

Each has a `read`, which makes `Geometry` of a file's bytes and raises `FormatError` for what is no such file.
"""
