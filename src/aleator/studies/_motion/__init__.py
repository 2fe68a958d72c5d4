"""Common parts of the motion planning studies: stages, results and presentation."""
