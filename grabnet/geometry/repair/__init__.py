"""Mending surfaces whose faces do not say which side is inside."""
