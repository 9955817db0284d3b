"""Where the filter meets a robot: controllers for many replays or one, and the closed loop."""
