"""Pose graphs: sessions of one or many robots, joined by loops, without being bent by wrong ones.

graph          trajectories and loops, how much odometry drifts, and the verdicts on loops
independence   how much of a loop its neighbours do not say already
variance_factor how much too large a graph states its uncertainties
consistency    sets of loops between two sessions that agree with each other
support        loops within a session that its odometry allows and that others support
placement      where sessions lie to each other before optimisation
least_squares  Levenberg and Marquardt, graduated non-convexity
jumps          odometry that begins anew, by its times
heading_bias   odometry whose heading turns steadily, by loops within its session
steady_faults  scale, slope and heading of odometry, by loops with other sessions
unconfirmed    steps that may be broken, and loops that these may explain, by the loops in the map
broken_steps   slips, jumps, turns and tilts of odometry, by loops on both sides
faults         faults of a session's odometry, and their mending
held_component a component as it was solved, as terms of least squares
odometry_weights odometry that the loops show to be better than it states
optimisation   the most likely poses, and which loops they rest on
anchors        places of points that the world outside tells, and how a map lies in that world
alignment      the place and heading of a level map by its anchors
absolute_edges terms of least squares that tie poses to the world
grounding      a map on earth: its anchors judged, its poses held by those that agree
normal_equations  errors and derivatives of many edges at once, and their factorisation
warm_start     one loop more on poses that were found before
g2o            graphs as text, for other tools

The order above is the order of the steps: find loops that agree, place the sessions by them, optimise robustly, drop
what does not fit, optimise what is left.

Names are imported from their modules: the gateway reads `graph` and `faults` without loading a solver.
"""
