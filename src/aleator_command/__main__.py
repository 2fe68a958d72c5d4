"""`python -m aleator_command`: the `aleator` command."""

from aleator_command import main

main()
