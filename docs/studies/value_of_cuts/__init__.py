"""Train and compare a value function of cuts: the number of parts of diameter h* that a piece will become."""
