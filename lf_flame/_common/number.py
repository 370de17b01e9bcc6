"""The type of what works on one number as on an array of them."""

from typing import TypeVar

import numpy as np

Number = TypeVar("Number", float, np.ndarray)
"""A number or an array: what goes in as one comes out as the same."""
