"""Robots that a policy can run on; each satisfies `deploy.interfaces.RobotInterface`."""
