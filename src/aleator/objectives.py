"""Objectives and constraints of motion plans beyond plain functionals (dissertation, chapters 3 to 5)."""

from aleator.design import coefficient_power as coefficient_power
from aleator.design import effort as effort
from aleator.design import final_time as final_time
from aleator.design import norm as norm
from aleator.design import power as power
from aleator.design import terminal_mean_error as terminal_mean_error
from aleator.design import terminal_variance as terminal_variance
from aleator.design import torque_rate as torque_rate
