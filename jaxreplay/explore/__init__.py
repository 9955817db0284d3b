"""A server for a browser on this machine: to see a study, to ask for runs, to drive the robot."""
