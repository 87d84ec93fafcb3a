"""The learning algorithm: networks, rollouts, PPO with discount regularisation."""
