"""Planning and executing the work on a collection; nothing else knows executors."""
