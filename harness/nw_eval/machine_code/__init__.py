"""Functions compiled to machine code by Numba, and where the code is kept."""
