"""Coefficients of one-step methods: explicit Runge-Kutta methods and linearly implicit ones (Rosenbrock-Wanner)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Row = tuple[float, ...]


class Tableau(NamedTuple):
    """A method whose stages follow one another (Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I,
    II.1, and II, IV.7, in the form without products of matrices and vectors).

    - `nodes`: the stages' times as fractions of a step; `couplings`: the coefficients of each stage on those before it;
      `weights`: those of the stages in the result; `errors`: those in its estimated error; `order`: that of the result
      of an adaptive method;
    - of linearly implicit methods: `diagonal`, the multiple of the Jacobian that each stage has; `implicit_couplings`,
      those of what the stages before contribute to its linear equations; `slopes`, its multiples of the rates' time
      derivatives.
    """

    nodes: Row
    couplings: tuple[Row, ...]
    weights: Row
    errors: Row = ()
    order: int = 0
    diagonal: float = 0.0
    implicit_couplings: tuple[Row, ...] = ()
    slopes: Row = ()

    @property
    def is_implicit(self) -> bool:
        """Whether stages are solutions of linear equations."""
        return self.diagonal != 0


def square(rows: tuple[Row, ...]) -> Float[np.ndarray, "stages stages"]:
    """Coefficients on the stages before each as a matrix."""
    return np.array([[*row, *[0.0] * (len(rows) - len(row))] for row in rows])


RUNGE_KUTTA_4 = Tableau(
    nodes=(0.0, 0.5, 0.5, 1.0),
    couplings=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)),
    weights=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
)

DORMAND_PRINCE_5 = Tableau(
    nodes=(0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
    couplings=(
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    ),
    weights=(35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
"""Dormand and Prince (1980)."""

_RESULT = (
    0.09646076681806523,
    0.01,
    0.4798896504144996,
    1.379008574103742,
    -3.290069515436081,
    2.324710524099774,
)
TSITOURAS_5 = Tableau(
    nodes=(0.0, 0.161, 0.327, 0.9, 0.9800255409045097, 1.0, 1.0),
    couplings=(
        (),
        (0.161,),
        (-0.008480655492356989, 0.335480655492357),
        (2.897153057105493, -6.359448489975075, 4.3622954328695815),
        (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
        (5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383),
        _RESULT,
    ),
    weights=(*_RESULT, 0.0),
    errors=(
        0.00178001105222577714,
        0.0008164344596567469,
        -0.007880878010261995,
        0.1447110071732629,
        -0.5823571654525552,
        0.45808210592918697,
        -1 / 66,
    ),
    order=5,
)
"""Tsitouras (Computers and Mathematics with Applications 62, 2011)."""

_SIXTH = (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946)
# Each of the last stages, at the end of the step, improves the result of the one before: the last one is the error.
RODAS_5P = Tableau(
    nodes=(0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0),
    couplings=(
        (),
        (3.0,),
        (2.849394379747939, 0.45842242204463923),
        (-6.954028509809101, 2.489845061869568, -10.358996098473584),
        (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
        _SIXTH,
        (*_SIXTH, 1.0),
        (*_SIXTH, 1.0, 1.0),
    ),
    weights=(*_SIXTH, 1.0, 1.0, 1.0),
    errors=(0.0,) * 7 + (1.0,),
    order=5,
    diagonal=0.21193756319429014,
    implicit_couplings=(
        (),
        (-14.155112264123755,),
        (-17.97296035885952, -2.859693295451294),
        (147.12150275711716, -1.41221402718213, 71.68940251302358),
        (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
        (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
        (
            *(30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783),
            *(-19.097331116725623, -28.087943162872662),
        ),
        (
            *(37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047),
            *(-40.06618937091002, -54.66780262877968, -9.48861652309627),
        ),
    ),
    slopes=(
        *(0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069),
        *(0.0, 0.0, 0.0),
    ),
)
"""Rodas5P (Steinebach, BIT Numerical Mathematics 63, 2023)."""
