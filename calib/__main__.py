"""`python -m calib`: the same as the command `calib`."""

from calib.cli import main

if __name__ == "__main__":
    main()
