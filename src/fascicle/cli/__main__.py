"""`python -m fascicle.cli`, for where the command is not on the path."""

from fascicle.cli import main

if __name__ == "__main__":
    main()
