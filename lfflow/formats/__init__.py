"""Bytes to arrays and metadata, and back."""
