"""`python -m aleator`: the `aleator` command."""

from aleator_command import main

if __name__ == "__main__":
    main()
