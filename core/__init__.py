"""Revisit's method: LiDAR scans in, implicit neural maps, fused place descriptors and verified loops out.

The modules in the order of the paper:

    scan, submap            posed scans over the travelled distance tau_n          III-A
    scan_marks              scans of a drive that are described                    beyond the paper
    scan_planes             scans over the planes that several of them see         beyond the paper
    scan_disagreement       how far the scans of a submap disagree                 beyond the paper
    odometry_bend           odometry that turns within a submap, straightened      beyond the paper
    implicit_map            elastic neural points and their decoder                III-B, Eq. 1-6
    surface                 mesh, normals and occupancy out of the field           III-C
    clusters                ground removal and fast Euclidean clustering           III-C
    bev                     cluster-guided BEV image, Log-Gabor, keypoints         III-D, III-E, Eq. 7-9
    micro                   saliency and angular histograms of the clusters        III-C, III-E, Eq. 10-12
    spectra                 spectra of faces and plan                              beyond the paper
    descriptor              aggregation and fusion                                 III-D, III-E, Eq. 13-15
    index                   nearest descriptors                                    III-E, Eq. 15
    place                   the recognition artefact of a submap                   III-E
    verification            start, registration, evidence, verdict of a pair       III-E
    acceptance              which pairs are sought, and which are loops            IV-B, beyond the paper
    pose_graph              consistent loops, robust optimisation                  beyond the paper
    merge                   one map out of several, changes, tiles                 beyond the paper
    relocalisation          where a robot is, narrowed down view by view           beyond the paper
    pipeline                describe a submap, verify a pair: the stages in order

Beside them: geometry (transforms, frames, voxel keys, the vertical of a cloud), kernels (compiled inner loops), codec
(stored bytes), config (all parameters), profiles (the paper's form), model_bundle (decoder and codebooks), sanity
(plausibility of the input), radio (which access points a place hears), point_columns (a point beside its coordinates),
pair_verdict (types of verdicts), stages (their names and times), string_enum (names as strings), errors.

Nothing here knows a network, a database, a clock or a file.
"""
