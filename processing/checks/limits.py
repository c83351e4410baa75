"""The numbers that decide what is named, in one table.

Sizes of samples and steps of iterations, which only cost time or memory, are where they are used.
"Correct recordings" are simulated ones of random objects, materials and lights, other than those of
the reported table.
"""

from __future__ import annotations

# What matters, in degrees of the normals and standard deviations; stated in docs/quality.md.
MATTERS_DEG = 1.0
MATTERS_SIGMAS = 1.0
FORBIDS_DEG = 5.0
FORBIDS_SIGMAS = 3.0
# Degrees: larger standard deviations count as this one. Mistakes enlarge residuals, and these the
# standard deviation.
LARGEST_SIGMA_DEG = 4.0
# The same if causes are compared with it, which were found in spite of the residual.
LARGEST_OF_CAUSES_DEG = 2.0
# Degrees: normals with a larger standard deviation are not good, whatever explains the residual.
UNCERTAIN_DEG = 8.0
# Share 0..1 of the squared residual above which the standard deviation is no excuse for a cause,
# and degrees that it may have then: effects are of first order, actual ones up to twice as large.
LARGE_SHARE = 0.2
LARGE_SHARE_DEG = 0.5

# Share 0..1 of the samples of the object: more saturated ones leave too few for some pixels.
SATURATED = 0.1

# Natural logarithm of the evidence of a cause: 30 is a probability of chance of 1e-13, which leaves
# room for what the model of correlated residuals lacks.
EVIDENCE = 30.0
# Share 0..1 of the squared residual that a cause foresees: gloss imitates causes up to 0.05.
FORESEEN = 0.06
# Standard deviations that a size exceeds.
SIGMAS = 3.0
# Share 0..1 of the evidence of the best cause: named with it, and a special case named instead.
TIED = 0.9
SPECIAL = 0.8
# Times the typical size of the parameter of an image: that image is named.
OUTSTANDING = 4.0
# Exponent of a transfer curve; none is larger (2.2 to 2.6).
LARGEST_POWER = 3.0

# Residual in another arrangement relative to the given one, 0..1: right ones leave up to 0.53 of
# that of wrong ones, because gloss stays.
BETTER = 0.6
# The same under another transfer curve: right ones leave up to 0.47, 0.76 in three real captures;
# of 90 correct recordings and these, another curve leaves 1.08 at least.
BETTER_CURVE = 0.85
# Residual, 0..1, that needs no other arrangement, and no explanation.
GOOD = 0.03
# Degrees, residual and times that of free lights: lights are in an unknown order. Another curve
# displaces two thirds of the lights by up to 12 degrees, shuffled lists by 20 and more.
SHUFFLED_DEG = 15.0
SHUFFLED_RESIDUAL = 0.1
SHUFFLED_FACTOR = 2.3
# Smallest relative to largest component of the normals that shows where lights are: 8 degrees.
LEAST_RELIEF = 0.04
# Degrees and standard deviations of a turn about the line of sight. Of 148 correct recordings, one
# exceeds both.
TURN_DEG = 1.5
TURN_SIGMAS = 4.0

# Curl under other axes relative to that under the given ones: movements of a sphere give 0.58.
AXES = 0.5
# Horizontal part of the normals at an outline that is steep, and the share of them that points
# inward: -0.95 and less of turned and mirrored objects, -0.1 and more of 66 correct ones.
STEEP = 0.45
INWARD = 0.8

# Residuals of single images in units of this times the typical one, and the least of these, 0..1.
TOLERATED = 3.0
LEAST_RESIDUAL = 0.02
# Cost 0..1 above the typical one at which an image is examined; the share of the excess that an
# explanation leaves; and the cost of an image that nothing explains.
EXCESS = 0.1
LEFT = 0.4
FOREIGN = 0.7
# Share 0..1 of the images: if more deviate, it is not known which are right.
MOST_IMAGES = 0.34
# Foreign rows deviate in this share of each third of their width, are at most this share of the
# object, and the next rows cost at most this more than usual: shadows begin gradually.
DEVIATING = 0.5
MOST_ROWS = 0.5
QUIET = 0.25
# Degrees: closer lights are the same; gloss imitates lamps that moved by less.
SAME_LIGHT_DEG = 2.0
MOVED_DEG = 6.0

# Robust fit of a block (Huber, 1964), standard deviations.
HUBER = 2.5
# Shares of the brightest sample of a block: darker predictions may be in shadow, negative ones
# beyond the second are; samples below this share of their prediction are in cast shadow.
DIM = 0.05
ATTACHED = 0.04
CAST = 0.35
