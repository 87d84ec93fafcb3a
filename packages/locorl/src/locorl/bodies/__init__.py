"""Which bodies to train and test on."""
