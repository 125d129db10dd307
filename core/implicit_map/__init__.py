"""Implicit submap: elastic neural points and their decoder (paper III-B, Eq. 1-6).

neural_points    insertion, movement, orientation                    Eq. 1
visibility       free-space evidence for the dynamic filter          Eq. 6
decoder          MLP from blended features to signed distance        Eq. 2-5
neighbourhood    neighbours, weights and encodings of queries        Eq. 2-4
samples          labelled samples along the rays
gradient_steps   fitting the features of a learned field
online_fitting   the same, one scan after the other
neural_map       the field and its queries
fitting          all of it, for one submap
settled          the geometry as it is stored (core.codec)
"""

from revisit.core.implicit_map.decoder import DecoderWeights
from revisit.core.implicit_map.fitting import fit_implicit_map
from revisit.core.implicit_map.neural_map import NeuralMap

__all__ = ["DecoderWeights", "NeuralMap", "fit_implicit_map"]
