"""The uncertain inputs of a function in their own units, and the outputs at given values of them."""

from collections import Counter
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
from aleator.ensemble import UNTRACEABLE, AbstractBox, Function, concrete, outputs_of, uncertain_places
from aleator.uncertainty import Normal, Placements, placements, realise, uncertain_numbers, with_distributions


@final
class Inputs:
    """The uncertain inputs of `function(model)`, with decisions at their initial values.

    - `distributions`: by name, at the initial decisions; `germs`: the distribution of each germ variable, by name;
    - `owned`: germ variables that belong to one input alone, which depends on no other, with that input's name.
    """

    def __init__(self, verb: str, function: Function, model: Pytree):
        if isinstance(function, AbstractBox):
            raise ProblemError(
                f"{verb}: a black box has no derivatives; expand it by al.expand, or sample it by "
                "al.references.monte_carlo."
            )
        self._places = uncertain_places(verb, function, model)
        self._verb, self._function = verb, function
        # A standard normal number equals its germ, so that values passed as the germ are the numbers themselves.
        self._in_units = with_distributions(model, lambda *_: Normal(0.0, 1.0))
        self.distributions = {name: distribution.initial() for name, distribution in self._places.distributions.items()}
        self.germs = self._places.germs
        needs = {name: distribution.germ_names(name) for name, distribution in self.distributions.items()}
        uses = Counter(germ for names in needs.values() for germ in names)
        self.owned = {germs[0]: name for name, germs in needs.items() if len(germs) == 1 and uses[germs[0]] == 1}

    def numbers(self, germ: Float[Array, " variables"]) -> Float[Array, " inputs"]:
        """The inputs at a germ point, in the order of `distributions`."""
        return jnp.stack(list(uncertain_numbers(self._places, germ, _initial(self._places)).values()))

    def outputs(self, values: Float[Array, " inputs"]) -> Pytree:
        """The outputs at given values of the inputs, in their units and in the order of `distributions`."""
        realised = realise(self._in_units, values, _initial(placements(self._in_units)))
        return outputs_of(self._function, realised, jnp)

    def refuse_nonfinite(self, expanded: Pytree) -> None:
        """Raise `SimulationError` if a value or derivative at the means is not finite, as far as values are known."""
        for leaf in jax.tree.leaves(expanded):
            known = concrete(leaf)
            if known is not None and not np.isfinite(known).all():
                where = ", ".join(f"{name} ~ {distribution}" for name, distribution in self.distributions.items())
                raise SimulationError(
                    f"{self._verb}: the function or its derivative is not finite at the means of {where}. It needs a "
                    "function that is smooth there: use al.references.monte_carlo."
                )


def _initial(places: Placements) -> Float[Array, " n"]:
    """The decisions at their initial values. A model in units has none inside distributions."""
    return jnp.asarray(places.vector("initial"))


def traceable(verb: str, function: Function) -> Function:
    """The function, with a clear error if JAX cannot differentiate it."""

    def checked(*arguments: Array) -> Pytree:
        try:
            return function(*arguments)
        except UNTRACEABLE as error:
            raise ProblemError(
                f"{verb}: JAX cannot differentiate the function ({str(error).splitlines()[0]}) Write it with jax.numpy."
            ) from error

    return checked
