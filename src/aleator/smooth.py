"""Switching right-hand sides over a stated width: `al.smooth.sign(v, width=1e-3)`."""

from aleator.dynamics._smooth import dead_zone as dead_zone
from aleator.dynamics._smooth import positive as positive
from aleator.dynamics._smooth import saturated as saturated
from aleator.dynamics._smooth import sign as sign
from aleator.dynamics._smooth import sign_residual as sign_residual
from aleator.dynamics._smooth import step as step
