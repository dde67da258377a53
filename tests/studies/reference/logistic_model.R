# Reference values of tests/studies/test_ordinal.py: glmer of lme4 on published data sets.
# Run in this folder: Rscript logistic_model.R    (lme4, jsonlite; writes logistic_model.json)
suppressPackageStartupMessages({
  library(lme4)
  library(jsonlite)
})
cbpp$herd <- as.character(cbpp$herd)
cbpp$period <- as.character(cbpp$period)
aggression <- VerbAgg[VerbAgg$id %in% levels(VerbAgg$id)[1:60], c("id", "btype", "situ", "mode", "r2")]
aggression$followed <- as.integer(aggression$r2 == "Y")
aggression <- data.frame(lapply(aggression[c("id", "btype", "situ", "mode", "followed")], function(x) if (is.factor(x)) as.character(x) else x))
sets <- list(
  "Lesnoff and others (2004): lme4::cbpp, Laplace" =
    list(data = cbpp, lhs = "cbind(incidence, size - incidence)", y = "incidence", trials = "size", fixed = "period", groups = "herd", points = 1),
  "Lesnoff and others (2004): lme4::cbpp, nine points" =
    list(data = cbpp, lhs = "cbind(incidence, size - incidence)", y = "incidence", trials = "size", fixed = "period", groups = "herd", points = 9),
  "De Boeck and Wilson (2004), the first 60 people: lme4::VerbAgg" =
    list(data = aggression, lhs = "followed", y = "followed", trials = NULL, fixed = "btype + situ * mode", groups = "id", points = 15)
)
analyse <- function(set) {
  # By default the inner search stops so early that Laplace's log-likelihood is 3e-4 too low for cbpp.
  control <- glmerControl(optimizer = "bobyqa", optCtrl = list(rhoend = 1e-10, maxfun = 1e5), tolPwrss = 1e-12)
  fit <- function(fixed) {
    glmer(as.formula(sprintf("%s ~ %s + (1 | %s)", set$lhs, fixed, set$groups)), set$data, binomial, control, nAGQ = set$points)
  }
  labels <- attr(terms(as.formula(paste("~", set$fixed))), "term.labels")
  tests <- lapply(labels, function(term) {
    own <- strsplit(term, ":")[[1]]
    above <- sapply(labels, function(x) all(own %in% strsplit(x, ":")[[1]]) && x != term)
    large <- labels[!above]
    small <- setdiff(large, term)
    found <- anova(fit(paste(c("1", small), collapse = "+")), fit(paste(c("1", large), collapse = "+")))
    list(term = term, chi2 = found[2, "Chisq"], df = found[2, "Df"], p = found[2, "Pr(>Chisq)"])
  })
  own <- fit(set$fixed)
  list(
    data = set$data, formula = paste(set$y, "~", set$fixed), trials = set$trials, groups = set$groups, points = set$points,
    tests = tests, names = names(fixef(own)), estimate = unname(fixef(own)), se = unname(sqrt(diag(as.matrix(vcov(own))))),
    variance = as.data.frame(VarCorr(own))$vcov, log_likelihood = as.numeric(logLik(own))
  )
}
out <- list(r = R.version.string, lme4 = as.character(packageVersion("lme4")), sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE, dataframe = "columns"), "logistic_model.json")
