"""Revisit's method: LiDAR scans in, implicit neural maps, fused place descriptors and verified loops out.

The modules in the order of the paper:

    scan, submap            posed scans over the travelled distance tau_n          III-A
    scan_disagreement       what the scans of a submap disagree on                 decision 0081
    implicit_map            elastic neural points and their decoder                III-B, Eq. 1-6
    surface                 mesh, normals and occupancy out of the field           III-C
    clusters                ground removal and fast Euclidean clustering           III-C
    bev                     cluster-guided BEV image, Log-Gabor, keypoints         III-D, III-E, Eq. 7-9
    micro                   saliency and angular histograms of the clusters        III-C, III-E, Eq. 10-12
    spectra                 spectra of faces and plan                              decision 0017
    descriptor              aggregation and fusion                                 III-D, III-E, Eq. 13-15
    index, candidates       nearest descriptors, and which may be loop closures    III-E, Eq. 15; IV-B
    place                   what is kept of a submap for verification              III-E
    correspondences         keypoints of two places that look alike                III-E
    verification            start, registration, evidence, verdict                 III-E
    acceptance              the claims of a drive judged together                  beyond the paper
    pose_graph              consistent loops, robust optimisation                  beyond the paper
    merge                   one map out of several                                 beyond the paper
    pipeline                the steps above, in order

Beside them: geometry (transforms, level frame, voxel keys), kernels (compiled inner loops), config (all parameters),
container (stored numbers), stages (their names and times), model_bundle (decoder and codebooks), sanity
(whether the input can be what it claims), upright (the vertical of a cloud without gravity), errors.

Nothing here knows a network, a database, a clock or a file.
"""
