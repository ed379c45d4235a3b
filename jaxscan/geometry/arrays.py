"""The array type of the house: JAX arrays inside compiled code, NumPy arrays on the host.

`Scanner` holds NumPy float64 on the host, so that its precision does not depend on whether
the caller enabled 64-bit JAX.
"""

import jax
import numpy as np


Array = jax.Array | np.ndarray
