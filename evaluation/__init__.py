"""How well the product recognises places: datasets, a LiDAR simulator, the paper's metrics, baselines and reports."""
