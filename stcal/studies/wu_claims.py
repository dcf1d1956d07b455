"""What Wu et al. 2019 finds, and what the study adds: the claims of the study ``wu``."""

from __future__ import annotations

from stcal.studies.findings import FAILS, HOLDS, OPEN, PARTLY, Claim

TOO_FEW = {OPEN: "Fewer than three runs cannot tell luck from skill."}

REACHES_BOUND = Claim(
    "Angular distances come within 5 % of what the data allow, in every group",
    "not in the paper",
    "Criterion A of AD is 0.535, 0.419 and 0.344 arcsec in groups 1 to 3; no bound is given.",
    {
        HOLDS: "All the separations of an image follow from 2 N - 3 of them. Weighted with their "
        "full, banded covariance these keep all that the centroids tell of the camera.",
        PARTLY: "In some group it loses more.",
        FAILS: "The filter loses information, or has not converged in so few images.",
    }
    | TOO_FEW,
)
VALUES_WIN = Claim(
    "Singular values win something against angular distances",
    "4.1, Test 3; conclusions",
    "They are as accurate, more stable, and much faster.",
    {
        HOLDS: "See the table for where; a difference beyond two standard errors comes about by "
        "chance in one comparison of forty.",
        FAILS: "They are functions of the same centroids, made of more of them each: they "
        "cannot tell more, and their covariance is a full matrix where that of the separations "
        "has a narrow band.",
    }
    | TOO_FEW,
)
TIME_IS_LINEAR = Claim(
    "The time of angular distances grows no faster than the number of stars",
    "4.1, Test 3, Table 4",
    "AD takes 4.68, 31.12 and 260.12 ms per image with 7.7, 19.1 and 31.4 stars.",
    {
        HOLDS: "2 N - 3 separations with a banded factor of their covariance, where N (N - 1) / 2 "
        "pairs need a full one. What every image costs regardless of its stars lowers the power.",
        PARTLY: "Faster than linear, but far from the paper's.",
        FAILS: "The machine was busy, or something in the filter grows with pairs of stars.",
    },
)
PUBLISHED_ABOVE_BOUND = Claim(
    "The published 0.465 arcsec leaves a factor of two to the bound",
    "4.1, Tables 2 to 4",
    "Criterion A of the recommended case in group 2 is 0.465 arcsec, said to be close to or "
    "better than that of angular distances.",
    {
        HOLDS: "With 0.5 px of noise, as stated, such data allow half of it. One variance for "
        "all values, the simplest reading of the paper, which doesn't give its R, loses as "
        "much or more. The bound is that of a sky that varies from image to image.",
        PARTLY: "It is above the bound, but not by as much.",
        FAILS: "The images of this run, fewer than the paper's, allow no more.",
    },
)
PUBLISHED_LUCKY = Claim(
    "The published 0.244 arcsec of group 3 takes a lucky run, if the noise is as stated",
    "4.1, Test 3, Table 4",
    "With 7.7 stars SVD has 0.244 arcsec, AD 0.344: the paper has one run of each.",
    {
        HOLDS: "A run's error is one draw of six parameters: from run to run it differs by a "
        "factor of two or three. Two methods must be compared on many runs, or on many images of "
        "the same noise.",
        PARTLY: "It is better than most runs, but not by much luck.",
        FAILS: "Most runs are as good.",
    },
)
MODEL_OBSERVABLE = Claim(
    "Model 4 observes the parameters best",
    "3.3.2, Figure 3",
    "The smallest singular value of the observability matrix is largest for Model 4 in most "
    "images.",
    {
        HOLDS: "Model 4's small groups see the short separations and its large ones the long ones.",
        PARTLY: "The order of an image's stars decides which stars are in a group together. "
        "The measure takes all values as equally accurate and independent, which they are not: "
        "Table 2 is the better judge.",
        FAILS: "Neither order makes Model 4 the best in most images of this run.",
    },
)
VALUE_OBSERVABLE = Claim(
    "The largest singular value observes least",
    "3.3.3, Figure 4",
    "The observability of σ1 is worse than that of σ2 and σ3.",
    {
        HOLDS: "In a narrow field all stars lie near the direction that σ1 belongs to; "
        "it changes only with the square of their distances from there.",
        PARTLY: "σ1 is the worst of the three more often than any other, yet not in most images.",
        FAILS: "In the images of this run another value is the worst more often.",
    },
)
MODEL_ACCURATE = Claim(
    "Model 4 is the most accurate",
    "4.1, Test 1, Table 2",
    "Criterion A is 0.465 arcsec with Model 4, and 0.852, 1.106 and 4.392 arcsec with Models 1 "
    "to 3.",
    {
        HOLDS: "Weighted with their full covariance the values of Model 4 keep nearly all that "
        "the centroids tell; those of Models 2 and 3 are too few for that.",
        PARTLY: "Model 4 has the smallest mean, but its lead over another model is within chance.",
        FAILS: "Another model has the smallest mean.",
    }
    | TOO_FEW,
)
VALUE_ACCURATE = Claim(
    "The best combinations are {σ1,σ2,σ3}, {σ2,σ3} and {σ2}",
    "4.1, Test 2, Table 3",
    "Criterion A is 0.472, 0.465 and 0.384 arcsec with these, and 0.701 to 3.383 arcsec with the "
    "others.",
    {
        HOLDS: "σ2 and σ3 are what separations change to the first order.",
        PARTLY: "The squares of an exact group's three values add up to its number of stars: any "
        "two of them tell the third. With their full covariance all pairs are worth the same, "
        "and {σ2} alone, one of two independent values, is worse. Weighed alike ("
        "constant R) σ1 does harm, as it does in the paper.",
        FAILS: "Other combinations are better than the two recommended ones.",
    }
    | TOO_FEW,
)
ALONE_UNSTABLE = Claim(
    "{σ2} alone is less stable than {σ2,σ3}",
    "4.1, Test 2, Table 3",
    "Its criterion A has a relatively high sd over images: 0.058 against 0.038 arcsec.",
    {
        HOLDS: "It observes one direction of an image only; the error of the others is larger, "
        "and shows where an image's stars lie along them.",
        PARTLY: "Larger beyond chance is one of the two sd only.",
        FAILS: "The difference is within chance.",
    }
    | TOO_FEW,
)
ACCURACY_ALIKE = Claim(
    "Singular values are about as accurate as angular distances",
    "4.1, Test 3, Table 4",
    "Criterion A of SVD is 0.436, 0.465 and 0.244 arcsec, that of AD 0.535, 0.419 and 0.344.",
    {
        HOLDS: "With their full covariance. The values of Model 4 keep all but one to four percent "
        "of what the centroids tell.",
        PARTLY: "In some group they lose more.",
        FAILS: "They lose more than the paper says.",
    }
    | TOO_FEW,
)
MORE_STABLE = Claim(
    "Singular values are more stable",
    "4.1, Test 3, Table 4",
    "The sd of criterion A over images is 0.039, 0.038 and 0.003 arcsec with SVD, and 0.293, 0.073 "
    "and 0.004 with AD.",
    {
        HOLDS: "Smaller beyond chance in all groups.",
        PARTLY: "Smaller beyond chance in some groups only.",
        FAILS: "The sd over images follows from the error of the camera, which is a matter of "
        "luck, and from how much the images differ. Weighted with their covariances both errors "
        "are nearly the same. The paper's 0.293 suggests an AD filter with a wrong covariance, its "
        "0.003 and 0.004 of 7.7 stars last images that show nearly the same sky.",
    }
    | TOO_FEW,
)
NOISE_FITTED_LESS = Claim(
    "By criterion B angular distances are always better",
    "4.1, Test 3, Table 4",
    "Criterion B of SVD is 10.854, 10.630 and 10.612 arcsec, that of AD 10.824, 10.608 and 10.611.",
    {
        HOLDS: "Nearly all of criterion B is centroid noise of images that no filter has seen: "
        "the larger error of the camera adds to it.",
        PARTLY: "Nearly all of criterion B is centroid noise of images that no filter has seen. "
        "The errors of the camera differ by too little to show in it in some group.",
        FAILS: "Nearly all of criterion B is centroid noise of images that no filter has seen. "
        "The errors of the camera differ by too little to show in it.",
    }
    | TOO_FEW,
)
FASTER = Claim(
    "Singular values take much less time",
    "4.1, Test 3, Table 4; conclusions",
    "14.36, 6.88 and 2.76 ms per image, against 260.12, 31.12 and 4.68 ms: 94.5, 78 and 41 % less.",
    {
        HOLDS: "Fewer values are to be computed and weighted.",
        PARTLY: "In some groups only.",
        FAILS: "The paper's AD grows with nearly the cube of the number of stars, as when all "
        "pairs are taken. 2 N - 3 separations with a banded factor tell the same, and are "
        "cheaper than the decomposition of N - 2 groups and the full covariance of their values.",
    },
)
CONVERGENCE_ALIKE = Claim(
    "Both converge alike",
    "4.1, Test 3, Figure 6",
    "The convergence rates of the two methods are similar in group 2.",
    {
        HOLDS: "Image by image both learn nearly all there is.",
        PARTLY: "One of the two needs clearly more images.",
        FAILS: "One of the two needs several times as many images, or doesn't get there.",
    },
)
