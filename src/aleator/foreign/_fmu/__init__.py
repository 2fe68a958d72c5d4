"""Functional mock-up units (FMI 2 and 3): read and loaded by FMPy, simulated, differentiated.

`_instance` calls the compiled code; `_library` simulates it, behind a door (`_doors`): in a process of its own or in
this one. `_fmu` says what a file offers, `_simulation` and `_system` are functions of JAX.
"""
