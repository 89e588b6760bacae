"""`python -m lfflow` is the same as the command `lfflow`."""

from lfflow.cli import main

if __name__ == "__main__":
    main()
