# Reference values of tests/studies/test_factorial.py: published data sets, analysed by afex (aov_car: car's Anova,
# type III) and emmeans. Run in this folder: Rscript factorial.R    (afex, emmeans, jsonlite, nlme; writes factorial.json)
suppressPackageStartupMessages({
  library(afex)
  library(emmeans)
  library(jsonlite)
  library(nlme)
})
afex_options(emmeans_model = "multivariate")
options(contrasts = c("contr.sum", "contr.poly"))

data(md_12.1, obk.long, md_15.1, md_16.4, sk2011.1, fhch2010, stroop, laptop_urry, package = "afex")
data(WeightLoss, package = "carData")

mean_of <- function(data, dv, by) aggregate(data[dv], data[by], mean)
complete <- function(data, id, cells) {
  counts <- table(data[[id]])
  droplevels(data[data[[id]] %in% names(counts)[counts == cells], ])
}
weight <- reshape(
  data.frame(id = seq_len(nrow(WeightLoss)), WeightLoss), direction = "long", idvar = "id", v.names = c("wl", "se"),
  varying = list(c("wl1", "wl2", "wl3"), c("se1", "se2", "se3")), timevar = "month"
)
body <- droplevels(as.data.frame(BodyWeight))
fhch <- droplevels(fhch2010[fhch2010$correct, ])
fhch <- mean_of(fhch, "log_rt", c("id", "task", "stimulus", "density", "frequency"))

sets <- list(
  "Maxwell and Delaney (2004), Table 12.1: afex::md_12.1" =
    list(data = md_12.1, id = "id", dv = "rt", within = c("angle", "noise"), between = character(0)),
  "O'Brien and Kaiser (1985), one group factor: afex::obk.long" =
    list(data = obk.long, id = "id", dv = "value", within = c("phase", "hour"), between = "treatment"),
  "O'Brien and Kaiser (1985), two group factors: afex::obk.long" =
    list(data = obk.long, id = "id", dv = "value", within = c("phase", "hour"), between = c("treatment", "gender")),
  "O'Brien and Kaiser (1985), with age: afex::obk.long" =
    list(data = obk.long, id = "id", dv = "value", within = c("phase", "hour"), between = "treatment", covariate = "age"),
  "Fox and Weisberg (2019), weight loss: carData::WeightLoss" =
    list(data = weight, id = "id", dv = "wl", within = "month", between = "group"),
  "Fox and Weisberg (2019), self esteem: carData::WeightLoss" =
    list(data = weight, id = "id", dv = "se", within = "month", between = "group"),
  "Potthoff and Roy (1964): nlme::Orthodont" =
    list(data = as.data.frame(Orthodont), id = "Subject", dv = "distance", within = "age", between = "Sex"),
  "Crowder and Hand (1990), chicks: datasets::ChickWeight" =
    list(data = complete(as.data.frame(ChickWeight), "Chick", 12), id = "Chick", dv = "weight", within = "Time", between = "Diet"),
  "Crowder and Hand (1990), rats: nlme::BodyWeight" =
    list(data = body, id = "Rat", dv = "weight", within = "Time", between = "Diet"),
  "Potvin, Lechowicz and Tardif (1990): datasets::CO2" =
    list(data = as.data.frame(CO2), id = "Plant", dv = "uptake", within = "conc", between = c("Type", "Treatment")),
  "Yates (1935), oats: nlme::Oats" =
    list(data = as.data.frame(Oats), id = "Block", dv = "yield", within = c("Variety", "nitro"), between = character(0)),
  "Singmann and Klauer (2011), experiment 1: afex::sk2011.1" =
    list(
      data = mean_of(sk2011.1, "response", c("id", "instruction", "inference", "plausibility")), id = "id", dv = "response",
      within = c("inference", "plausibility"), between = "instruction"
    ),
  "Freeman, Heathcote, Chalmers and Hockley (2010): afex::fhch2010" =
    list(data = fhch, id = "id", dv = "log_rt", within = c("stimulus", "density", "frequency"), between = "task"),
  "Pinheiro and Bates (2000), machines: nlme::Machines" =
    list(
      data = transform(as.data.frame(Machines), take = ave(score, Worker, Machine, FUN = seq_along)), id = "Worker",
      dv = "score", within = c("Machine", "take"), between = character(0)
    )
)

analyse <- function(set) {
  data <- set$data
  for (name in c(set$id, set$within, set$between)) data[[name]] <- factor(as.character(data[[name]]))
  covariate <- set$covariate
  if (!is.null(covariate)) {
    data$centred <- data[[covariate]] - mean(tapply(data[[covariate]], data[[set$id]], mean))
  }
  sides <- c(if (length(set$between)) paste(set$between, collapse = "*"), if (!is.null(covariate)) "centred")
  left <- if (length(sides)) paste(sides, collapse = " + ") else "1"
  formula <- as.formula(sprintf("%s ~ %s + Error(%s/(%s))", set$dv, left, set$id, paste(set$within, collapse = "*")))
  fit <- suppressMessages(suppressWarnings(
    aov_car(formula, data, anova_table = list(correction = "none", es = c("ges", "pes")), factorize = FALSE, include_aov = FALSE)
  ))
  table <- fit$anova_table
  own <- suppressWarnings(summary(fit$Anova, multivariate = FALSE))
  tests <- own$sphericity.tests
  adjusted <- own$pval.adjustments
  univariate <- own$univariate.tests
  pick <- function(x, row, column) if (!is.null(x) && row %in% rownames(x)) x[row, column] else NA
  effects <- lapply(rownames(table), function(row) list(
    effect = gsub("centred", covariate %||% "", row), F = table[row, "F"], df1 = table[row, "num Df"], df2 = table[row, "den Df"],
    p = table[row, "Pr(>F)"], eta2_generalized = table[row, "ges"], eta2_partial = table[row, "pes"],
    ss_effect = univariate[row, "Sum Sq"], ss_error = univariate[row, "Error SS"],
    mauchly_w = pick(tests, row, "Test statistic"), mauchly_p = pick(tests, row, "p-value"),
    epsilon_gg = pick(adjusted, row, "GG eps"), p_gg = pick(adjusted, row, "Pr(>F[GG])"),
    epsilon_hf_untruncated = pick(adjusted, row, "HF eps"), p_hf = pick(adjusted, row, "Pr(>F[HF])")
  ))
  pairs_of <- function(factor, at) {
    spec <- if (is.na(at)) as.formula(paste("~", factor)) else as.formula(paste("~", factor, "|", at))
    found <- as.data.frame(summary(pairs(emmeans(fit, spec)), infer = TRUE, adjust = "none"))
    held <- as.data.frame(summary(pairs(emmeans(fit, spec)), adjust = "holm"))
    list(
      factor = factor, at = at, level = if (is.na(at)) "" else as.character(found[[at]]), contrast = as.character(found$contrast),
      mean_difference = found$estimate, ci_low = found$lower.CL, ci_high = found$upper.CL, t = found$t.ratio, df = found$df,
      p = found$p.value, p_holm = held$p.value
    )
  }
  factors <- c(set$within, set$between)
  compared <- list()
  if (is.null(covariate) && length(factors) >= 2) {
    compared <- list(pairs_of(factors[1], NA), pairs_of(factors[length(factors)], NA), pairs_of(factors[1], factors[2]))
    if (length(set$between)) compared <- c(compared, list(pairs_of(set$between[1], set$within[1])))
  }
  list(
    columns = data[c(set$id, set$dv, set$within, set$between, covariate)], id = set$id, dv = set$dv, within = I(set$within),
    between = I(set$between), covariate = covariate %||% NA, effects = effects, pairs = compared
  )
}
`%||%` <- function(a, b) if (is.null(a)) b else a

versions <- sapply(c("afex", "car", "emmeans", "nlme", "carData"), function(x) as.character(packageVersion(x)))
out <- list(r = R.version.string, packages = as.list(versions), sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE, dataframe = "columns", na = "null"), "factorial.json")
