"""Numbers of the damped least squares solvers, each chosen by measurement (`icub benchmark kinematics`)."""

DAMPING = 1e-4  # added to the diagonal of J J^T; 1e-3 loses a tenth of the reachable targets
MAX_STEP = 0.7  # rad, of any joint in one iteration: the linearization is worth little beyond
POSTURE_GAIN = 0.5  # share of the way back to the reference posture taken by the first iteration in the null space
POSTURE_DECAY = 0.7  # of that share per iteration: a constant pull would keep the descent from converging
CONVERGED = 0.1  # an iterate within this share of both tolerances ends the descent
PATIENCE = 3  # iterations without progress that end a descent
MIN_PROGRESS = 0.7  # ratio of squared errors that counts as progress; 0.9 costs a fifth more time and reaches no more
RESTARTS = 4  # further starts of a solve that did not reach; one descent reaches 0.96, five 1.00 of random targets
AT_LIMIT = 1e-9  # rad
