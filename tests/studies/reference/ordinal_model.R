# Reference values of tests/studies/test_ordinal.py: clmm and clmm2 of ordinal.
# Run in this folder: Rscript ordinal_model.R    (ordinal, lme4, jsonlite; writes ordinal_model.json)
suppressPackageStartupMessages({
  library(ordinal)
  library(lme4)
  library(jsonlite)
})
data(wine, package = "ordinal")
wine2 <- data.frame(judge = as.character(wine$judge), temp = as.character(wine$temp), contact = as.character(wine$contact),
                    rating = as.integer(wine$rating))
aggression <- VerbAgg[VerbAgg$id %in% levels(VerbAgg$id)[1:40], c("id", "situ", "mode", "resp")]
verbal <- data.frame(id = as.character(aggression$id), situ = as.character(aggression$situ), mode = as.character(aggression$mode),
                     answer = as.integer(aggression$resp))
control <- clmm.control(gradTol = 1e-9, maxIter = 500, maxLineIter = 200)
describe <- function(m) {
  n <- length(m$alpha); b <- length(m$beta)
  list(estimate = unname(m$beta), se = unname(sqrt(diag(vcov(m)))[n + seq_len(b)]), thresholds = unname(m$alpha),
       thresholds_se = unname(sqrt(diag(vcov(m)))[seq_len(n)]), log_likelihood = as.numeric(logLik(m)),
       covariance = unname(as.matrix(VarCorr(m)[[1]])))
}
wine$r <- factor(wine$rating, ordered = TRUE)
nine <- clmm(r ~ temp * contact + (1 | judge), wine, nAGQ = 9, control = control)
both <- clmm(r ~ temp + contact + (1 | judge), wine, nAGQ = 9, control = control)
no_temp <- clmm(r ~ contact + (1 | judge), wine, nAGQ = 9, control = control)
no_contact <- clmm(r ~ temp + (1 | judge), wine, nAGQ = 9, control = control)
chi2 <- function(small, large) as.numeric(2 * (logLik(large) - logLik(small)))
wide <- clmm2(factor(answer, ordered = TRUE) ~ situ + mode, random = factor(id), data = verbal, nAGQ = 15, Hess = TRUE)
nominal <- clmm2(factor(answer, ordered = TRUE) ~ situ, nominal = ~mode, random = factor(id), data = verbal, nAGQ = 15, Hess = TRUE)
out <- list(
  r = R.version.string, ordinal = as.character(packageVersion("ordinal")), lme4 = as.character(packageVersion("lme4")),
  wine = wine2, verbal = verbal,
  interaction = describe(nine),
  tests = list(temp = chi2(no_temp, both), contact = chi2(no_contact, both), interaction = chi2(both, nine)),
  proportional = list(location = as.numeric(logLik(wide)), nominal = as.numeric(logLik(nominal)))
)
write(toJSON(out, digits = NA, auto_unbox = TRUE, dataframe = "columns"), "ordinal_model.json")
