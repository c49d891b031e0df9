"""Vectors of float32 lanes for kernels: the types, their operators, loads and stores.

lanes.py      Float8 and Floats16: float32 lanes, their operators and masks
memory.py     loads and stores of lanes and of single elements
"""
