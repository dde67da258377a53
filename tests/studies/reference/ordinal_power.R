# Power of tests/studies/test_ordinal.py: studies simulated and tested by clmm of ordinal.
# Run in this folder: Rscript ordinal_power.R    (ordinal, jsonlite; writes ordinal_power.json)
suppressPackageStartupMessages({
  library(ordinal)
  library(jsonlite)
})
set.seed(1)
replicates <- 150
first <- c(.1, .2, .3, .25, .15)
cuts <- qlogis(cumsum(first)[1:4])
share <- function(n, shift, sd) {
  rejected <- replicate(replicates, {
    person <- rep(seq_len(n), each = 2)
    condition <- rep(0:1, n)
    latent <- rnorm(n, 0, sd)[person] + shift * condition + rlogis(2 * n)
    frame <- data.frame(person = factor(person), condition = condition, rating = factor(findInterval(latent, cuts), ordered = TRUE))
    with_it <- clmm(rating ~ condition + (1 | person), frame, nAGQ = 9)
    without <- clmm(rating ~ 1 + (1 | person), frame, nAGQ = 9)
    2 * as.numeric(logLik(with_it) - logLik(without)) > qchisq(.95, 1)
  })
  sum(rejected)
}
cases <- list(c(12, 0, 1), c(12, 1, 1), c(24, 1, 1))
rows <- lapply(cases, function(case) list(n = case[1], shift = case[2], sd = case[3], rejected = share(case[1], case[2], case[3])))
write(toJSON(list(r = R.version.string, ordinal = as.character(packageVersion("ordinal")), replicates = replicates, first = first, cases = rows),
             auto_unbox = TRUE), "ordinal_power.json")
