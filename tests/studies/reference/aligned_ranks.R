# Reference values of tests/studies/test_aligned_ranks.py: alignment by ave() and lm(), tests by afex (own error terms) and
# lmerTest (random intercepts), contrasts by emmeans. Run in this folder: Rscript aligned_ranks.R    (writes aligned_ranks.json)
suppressPackageStartupMessages({
  library(afex)
  library(emmeans)
  library(lmerTest)
  library(jsonlite)
})
options(contrasts = c("contr.sum", "contr.poly"))
emm_options(lmer.df = "satterthwaite")
data(md_12.1, obk.long, package = "afex")
plants <- as.data.frame(CO2)
plants$conc <- paste0("c", plants$conc)
sets <- list(
  "Maxwell and Delaney (2004), Table 12.1: afex::md_12.1" =
    list(data = md_12.1, id = "id", dv = "rt", within = c("angle", "noise"), between = character(0), balanced = TRUE),
  "Potvin, Lechowicz and Tardif (1990): datasets::CO2" =
    list(data = plants, id = "Plant", dv = "uptake", within = "conc", between = c("Type", "Treatment"), balanced = TRUE),
  "O'Brien and Kaiser (1985), one group factor: afex::obk.long" =
    list(data = obk.long, id = "id", dv = "value", within = c("phase", "hour"), between = "treatment", balanced = FALSE)
)
cells <- function(data, names) if (length(names)) interaction(data[names], drop = TRUE) else factor(rep(1, nrow(data)))
subsets <- function(names) unlist(lapply(0:length(names), function(k) combn(names, k, simplify = FALSE)), recursive = FALSE)
aligned <- function(set, own) {
  y <- set$data[[set$dv]]
  all <- c(set$between, set$within)
  effect <- Reduce(`+`, lapply(subsets(own), function(s) (-1)^(length(own) - length(s)) * ave(y, cells(set$data, s))))
  rank(round(y - ave(y, cells(set$data, all)) + effect, 8))
}
analyse <- function(set) {
  data <- set$data
  all <- c(set$between, set$within)
  for (name in c(all, set$id)) data[[name]] <- factor(as.character(data[[name]]))
  set$data <- data
  star <- paste(all, collapse = " * ")
  effects <- lapply(subsets(all)[-1], function(own) {
    data$rank <- aligned(set, own)
    term <- paste(own, collapse = ":")
    fit <- aov_car(as.formula(sprintf("rank ~ %s + Error(%s / (%s))", star, set$id, paste(set$within, collapse = " * "))), data)
    found <- fit$anova_table[term, ]
    row <- list(effect = term, F = found[["F"]])
    if (set$balanced) {
      mixed <- anova(lmer(as.formula(sprintf("rank ~ %s + (1 | %s)", star, set$id)), data))
      row <- c(row, list(F_pooled = mixed[term, "F value"], df_pooled = mixed[term, "DenDF"]))
    }
    row
  })
  contrasts <- list()
  if (set$balanced) {
    pair <- tail(all, 2)
    y <- data[[set$dv]]
    data$rank <- rank(round(y - ave(y, cells(data, all)) + ave(y, cells(data, pair)) - mean(y), 8))
    fit <- lmer(as.formula(sprintf("rank ~ %s + (1 | %s)", star, set$id)), data)
    contrasts <- lapply(1:2, function(i) {
      found <- as.data.frame(summary(pairs(emmeans(fit, pair[i], by = pair[3 - i])), adjust = "none"))
      list(factor = pair[i], at = pair[3 - i], contrast = as.character(found$contrast), level = as.character(found[[pair[3 - i]]]),
        estimate = found$estimate, t = found$t.ratio, df = found$df)
    })
  }
  columns <- data[c(set$id, all, set$dv)]
  for (name in names(columns)) if (is.factor(columns[[name]])) columns[[name]] <- as.character(columns[[name]])
  list(columns = columns, id = set$id, dv = set$dv, within = I(set$within), between = I(set$between), effects = effects,
    contrasts = contrasts)
}
out <- list(r = R.version.string, sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE, dataframe = "columns"), "aligned_ranks.json")
