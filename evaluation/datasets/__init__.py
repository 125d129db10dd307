"""Recordings on disk: KITTI odometry folders, read lazily and written for simulated drives."""

from evaluation.datasets.kitti import KittiRecording, write_kitti
from evaluation.datasets.recording import Recording

__all__ = ["KittiRecording", "Recording", "write_kitti"]
