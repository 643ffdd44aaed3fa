"""Faults of the machine: killed processes, full disks, folders that cannot be written."""
