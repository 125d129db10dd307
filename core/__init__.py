"""Revisit's method: LiDAR scans in, implicit neural maps, fused place descriptors and verified loops out.

The modules in the order of the paper:

    scan, submap            posed scans over the travelled distance tau_n          III-A
    implicit_map            elastic neural points and their decoder                III-B, Eq. 1-6
    surface                 mesh, normals and occupancy out of the field           III-C
    clusters                ground removal and fast Euclidean clustering           III-C
    bev                     cluster-guided BEV image, Log-Gabor, keypoints         III-D, III-E, Eq. 7-9
    cluster_normals         72-region angular histograms                           III-C
    saliency                keypoints weigh and schedule the clusters              III-E, Eq. 10-12
    vlad, descriptor        aggregation and fusion                                 III-D, III-E, Eq. 13-15
    index                   nearest descriptors                                    III-E, Eq. 15
    place                   what is kept of a submap for verification              III-E
    verification            correspondences, start, registration, verdict          III-E
    pipeline                the steps above, in order

Nothing here knows a network, a database, a clock or a file.
"""
