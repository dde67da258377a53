# Reference values of tests/studies/test_mixed.py: lme4 on published data sets.
# Run in this folder: Rscript formula_model.R    (lme4, nlme, jsonlite; writes formula_model.json)
suppressPackageStartupMessages({
  library(lme4)
  library(jsonlite)
})
orthodont <- as.data.frame(nlme::Orthodont)
orthodont$Sex <- as.character(orthodont$Sex)
orthodont$Subject <- as.character(orthodont$Subject)
oats <- as.data.frame(nlme::Oats)[-c(3, 17, 40), ]
oats$Block <- as.character(oats$Block)
oats$Variety <- as.character(oats$Variety)
sets <- list(
  "Potthoff and Roy (1964): nlme::Orthodont" =
    list(data = orthodont, y = "distance", fixed = "age * Sex", groups = "Subject"),
  "Yates (1935), three plots missing: nlme::Oats" =
    list(data = oats, y = "yield", fixed = "nitro + Variety", groups = "Block")
)
analyse <- function(set) {
  control <- lmerControl(optimizer = "bobyqa", optCtrl = list(rhoend = 1e-10))
  fit <- function(fixed, reml = FALSE) {
    lmer(as.formula(sprintf("%s ~ %s + (1 | %s)", set$y, fixed, set$groups)), set$data, REML = reml, control = control)
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
  own <- fit(set$fixed, TRUE)
  vc <- as.data.frame(VarCorr(own))
  list(
    data = set$data, formula = paste(set$y, "~", set$fixed), groups = set$groups, tests = tests,
    estimate = unname(fixef(own)), se = unname(sqrt(diag(as.matrix(vcov(own))))),
    variances = vc$vcov[is.na(vc$var2)], log_likelihood = as.numeric(logLik(fit(set$fixed))),
    singular = isSingular(own, tol = 1e-6)
  )
}
out <- list(r = R.version.string, lme4 = as.character(packageVersion("lme4")), sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE, dataframe = "columns"), "formula_model.json")
