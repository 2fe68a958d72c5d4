"""Functions of statistics and decisions beyond sums, products, quotients and powers."""

from aleator.design import function as function
from aleator.design import maximum as maximum
from aleator.design import minimum as minimum
from aleator.design import positive_part as positive_part
