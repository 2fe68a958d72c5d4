"""Functional mock-up units (FMI 2 and 3): read and loaded by FMPy, simulated, differentiated.

`_library` calls the compiled code; `_fmu` says what a file offers, and asks its library in a process of its own or in
this one; `_functions` has functions of JAX.
"""
