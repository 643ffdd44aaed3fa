"""The command line with invalid input, killed processes and full disks."""
