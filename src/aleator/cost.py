"""What tolerances cost to make: `al.cost.reciprocal(...)` (dissertation, chapter 7)."""

from aleator.design import cost_curve as cost_curve
from aleator.design import exponential as exponential
from aleator.design import reciprocal as reciprocal
from aleator.design import reciprocal_power as reciprocal_power
from aleator.design import reciprocal_squared as reciprocal_squared
