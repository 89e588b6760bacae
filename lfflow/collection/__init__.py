"""The on-disk layout of a collection; nothing else knows it."""
