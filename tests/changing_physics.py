"""A module of physics of its own, for models that read it: what stands here may change under them."""

GOAL = 1.0


def goal():
    """Where a model that calls this is to go."""
    return GOAL
