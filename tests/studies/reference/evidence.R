# Reference values of tests/studies/test_paired.py: paired Bayes factors of R's BayesFactor, and two one-sided t-tests of R's t.test.
# Run in this folder: Rscript evidence.R    (BayesFactor, jsonlite; writes evidence.json)
suppressPackageStartupMessages({
  library(BayesFactor)
  library(jsonlite)
})
set.seed(3)
sets <- list(
  sleep = list(a = sleep$extra[sleep$group == 1], b = sleep$extra[sleep$group == 2]),
  no_difference = list(a = rnorm(40), b = rnorm(40)),
  large = { x <- rnorm(25); list(a = x, b = x + rnorm(25, 0.8, 0.6)) }
)
analyse <- function(x, bound = 0.5) {
  low <- t.test(x$a, x$b, paired = TRUE, mu = -bound, alternative = "greater")
  high <- t.test(x$a, x$b, paired = TRUE, mu = bound, alternative = "less")
  ci <- t.test(x$a, x$b, paired = TRUE, conf.level = 0.9)$conf.int
  bf <- function(r) extractBF(ttestBF(x$a, x$b, paired = TRUE, rscale = r))$bf
  c(x, list(
    bf10 = bf(sqrt(0.5)), bf10_wide = bf(1), t_low = unname(low$statistic), p_low = low$p.value,
    t_high = unname(high$statistic), p_high = high$p.value, ci_low = ci[1], ci_high = ci[2]
  ))
}
packages <- list(BayesFactor = as.character(packageVersion("BayesFactor")))
write(toJSON(list(r = R.version.string, packages = packages, sets = lapply(sets, analyse)), digits = NA, auto_unbox = TRUE), "evidence.json")
