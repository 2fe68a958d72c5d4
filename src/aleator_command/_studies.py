"""The case studies by name, and what each is about, for whoever lists them without JAX."""

STUDIES = {
    "suspension": "Quarter car: deterministic, robust and apportioned suspension (sections 6.4 and 7.4)",
    "clutch": "One-way clutch: tolerance analysis by every method, and the cheapest tolerances (section 7.2)",
    "pick-and-place-effort": "Two-link arm, uncertain payload: least effort, least spread at the end (section 5.5.1)",
    "pick-and-place-time": "Two-link arm, uncertain payload: least time, and the margin that it takes (section 5.5.2)",
    "swing-up": "Double pendulum of uncertain mass, driven at one joint: swing-up of least energy (section 5.5.3)",
    "four-bar": "Straight-line linkage, a closed loop driven by its crank: robust lengths, and the cheapest tolerances",
}
