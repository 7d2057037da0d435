"""Runs the command line by `python -m radiometer`."""

from radiometer.cli.main import main

if __name__ == "__main__":
    main()
