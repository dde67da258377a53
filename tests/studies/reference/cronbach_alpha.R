# Reference values of test_alpha_agrees_with_r in tests/studies/test_questionnaires.py.
# Run in this folder: Rscript cronbach_alpha.R    (R with packages psych and jsonlite; writes cronbach_alpha.json)
library(jsonlite)
suppressPackageStartupMessages(library(psych))

set.seed(12)
likert <- function(n, k, share) {
  x <- sqrt(share) * rnorm(n) + sqrt(1 - share) * matrix(rnorm(n * k), n)
  pmin(pmax(round(4 + 1.5 * x), 1), 7)
}
sets <- list(twelve = likert(40, 12, 0.5), three = likert(15, 3, 0.3), two = likert(8, 2, 0.6), weak = likert(25, 5, 0))
analyse <- function(x) {
  a <- suppressWarnings(psych::alpha(as.data.frame(x), check.keys = FALSE, warnings = FALSE))
  v <- cov(x)
  k <- ncol(x)
  alpha <- k / (k - 1) * (1 - sum(diag(v)) / sum(v))
  stopifnot(abs(alpha - a$total$raw_alpha) < 1e-12)
  list(
    items = x, alpha = alpha,
    ci_low = unname(unlist(a$feldt$lower.ci)[1]), ci_high = unname(unlist(a$feldt$upper.ci)[1]),
    without = if (k > 2) a$alpha.drop$raw_alpha else list()
  )
}
out <- list(r = R.version.string, psych = as.character(packageVersion("psych")), sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE), "cronbach_alpha.json")
