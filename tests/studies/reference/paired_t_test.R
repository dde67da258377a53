# Reference values of tests/studies/test_paired_t_test.py.
# Differences are ranked to twelve digits, or floating point would separate ties (1.1 - 1.0 and 0.1).
# Run in this folder: Rscript paired_t_test.R    (R and its package jsonlite; writes paired_t_test.json)
library(jsonlite)

set.seed(20)
base <- rnorm(36, 60, 15)
skew <- rexp(60)
sets <- list(
  sleep = list(a = sleep$extra[sleep$group == 1], b = sleep$extra[sleep$group == 2]),
  followed = list(a = round(base + rnorm(36, 5, 20), 2), b = round(base - rnorm(36, 5, 20), 2)),
  likert = list(a = sample(1:7, 30, replace = TRUE), b = sample(2:7, 30, replace = TRUE)),
  many = list(a = round(skew, 4), b = round(skew^2 + rnorm(60), 4)),
  three = list(a = c(1.5, 2.25, 7), b = c(1, 3, 4)),
  large = list(a = 1e6 + round(rnorm(12), 3), b = 1e6 + round(rnorm(12, 0.5), 3))
)

analyse <- function(x) {
  d <- x$a - x$b
  t95 <- t.test(x$a, x$b, paired = TRUE)
  t90 <- t.test(x$a, x$b, paired = TRUE, conf.level = 0.9)
  w <- suppressWarnings(wilcox.test(x$a, x$b, paired = TRUE, digits.rank = 12))
  s <- shapiro.test(d)
  list(
    a = x$a, b = x$b,
    mean_difference = unname(t95$estimate), sd_difference = sd(d),
    ci_low = t95$conf.int[1], ci_high = t95$conf.int[2],
    ci90_low = t90$conf.int[1], ci90_high = t90$conf.int[2],
    t = unname(t95$statistic), df = unname(t95$parameter), p = t95$p.value,
    d_z = mean(d) / sd(d), d_av = mean(d) / ((sd(x$a) + sd(x$b)) / 2),
    correlation = cor(x$a, x$b),
    wilcoxon_v = unname(w$statistic), wilcoxon_p = w$p.value, wilcoxon_method = w$method,
    shapiro_w = unname(s$statistic), shapiro_p = s$p.value
  )
}
out <- list(r = R.version.string, sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE, pretty = TRUE), "paired_t_test.json")
