"""Functions of a model's realisations at many germ points: traced or called, in batches, with failures named."""

from aleator.ensemble._batches import Part as Part
from aleator.ensemble._batches import each as each
from aleator.ensemble._batches import few_at_once as few_at_once
from aleator.ensemble._batches import fill as fill
from aleator.ensemble._batches import in_batches as in_batches
from aleator.ensemble._batches import parts as parts
from aleator.ensemble._ensemble import AbstractEnsemble as AbstractEnsemble
from aleator.ensemble._ensemble import CalledEnsemble as CalledEnsemble
from aleator.ensemble._ensemble import TracedEnsemble as TracedEnsemble
from aleator.ensemble._ensemble import uncertain_places as uncertain_places
from aleator.ensemble._levels import at_levels as at_levels
from aleator.ensemble._levels import draw as draw
from aleator.ensemble._levels import random_levels as random_levels
from aleator.ensemble._outputs import UNTRACEABLE as UNTRACEABLE
from aleator.ensemble._outputs import Function as Function
from aleator.ensemble._outputs import concrete as concrete
from aleator.ensemble._outputs import inputs_at as inputs_at
from aleator.ensemble._outputs import listed as listed
from aleator.ensemble._outputs import name_of as name_of
from aleator.ensemble._outputs import outputs_of as outputs_of
from aleator.ensemble._outputs import part as part
from aleator.ensemble._outputs import refuse_nonfinite as refuse_nonfinite
