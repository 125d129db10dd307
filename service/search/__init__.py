"""Search processes: they hold the indices of maps, and gateways and workers ask them."""
