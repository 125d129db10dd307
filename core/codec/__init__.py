"""Stored bytes of places, neural maps, meshes and tiles: the current form of each, to the same bytes everywhere.

place                  a place: place_head, place_keypoints (plain_keypoints: read without compiled code), place_surface
neural_map             sections of a neural map; neural_points, the stream of its points, by neural_chances
known_points           points that were read or written lately
mesh, tile             surfaces on a grid of a millimetre; neural map, mesh and points of a tile
container              magic, header, body and checksum; refusal of former forms
learned_chances        with which models of bits begin

Range coders and their models are in `core.kernels`, beside everything that is compiled.
"""
