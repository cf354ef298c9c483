"""Recordings of the open bodies with the open objects, in GRAB's layout: planned, moved by inverse kinematics, checked.

Everything is planned in the body's rest frame (metres; x to its left, y up, z ahead, pelvis at the origin at rest).
"""
