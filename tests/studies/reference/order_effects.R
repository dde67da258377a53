# Reference values of tests/studies/test_order_effects.py: full and reduced regressions by R's lm, drop1-wise.
# Run in this folder: Rscript order_effects.R    (emmeans, jsonlite; writes order_effects.json)
suppressPackageStartupMessages({
  library(emmeans)
  library(jsonlite)
})
williams <- rbind(c(1, 2, 4, 3), c(2, 3, 1, 4), c(3, 4, 2, 1), c(4, 1, 3, 2))
draw <- function(seed, orders, carried) {
  set.seed(seed)
  k <- ncol(orders)
  rows <- do.call(rbind, lapply(seq_len(nrow(orders)), function(s) {
    own <- orders[s, ]
    before <- c(0, own[-k])
    data.frame(subject = s, position = seq_len(k), condition = own, score = rnorm(1, 0, 2) + 0.3 * seq_len(k) + 0.5 * own + carried * before + rnorm(k))
  }))
  rows
}
orchard <- with(OrchardSprays, data.frame(subject = rowpos, position = colpos, condition = as.integer(treatment), score = decrease))
sets <- list(
  "Williams design of four conditions" = draw(1, williams[rep(1:4, 3), ], 0.4),
  "Latin square without balance" = draw(2, rbind(1:4, c(2, 3, 4, 1), c(3, 4, 1, 2), c(4, 1, 2, 3))[rep(1:4, 2), ], 0),
  "two conditions" = draw(3, rbind(1:2, 2:1)[rep(1:2, 5), ], 0),
  "Finney (1947), orchard sprays: datasets::OrchardSprays" = orchard
)
analyse <- function(data) {
  data <- data[order(data$subject, data$position), ]
  k <- max(data$condition)
  before <- unlist(tapply(data$condition, data$subject, function(x) c(0, x[-length(x)]), simplify = FALSE))
  carry <- sapply(seq_len(k - 1), function(j) (before == j) - (before == k))
  data$carry <- carry
  for (name in c("subject", "position", "condition")) data[[name]] <- factor(data[[name]])
  full <- lm(score ~ subject + position + condition + carry, data)
  simple <- lm(score ~ subject + position + condition, data)
  test <- function(large, small) {
    found <- anova(small, large)
    list(ss = found[2, "Sum of Sq"], df1 = found[2, "Df"], df2 = found[2, "Res.Df"], F = found[2, "F"], p = found[2, "Pr(>F)"])
  }
  base <- if (any(is.na(coef(full)))) simple else full
  pairs <- as.data.frame(summary(pairs(emmeans(simple, ~condition)), adjust = "none"))
  own <- if (identical(base, full)) {
    v <- vcov(full); b <- coef(full)
    t(apply(combn(k, 2), 2, function(ij) {
      l <- setNames(numeric(length(b)), names(b))
      for (s in 1:2) if (ij[s] > 1) l[paste0("condition", ij[s])] <- c(1, -1)[s]
      c(ij, sum(l * b), sqrt(c(t(l) %*% v %*% l)))
    }))
  } else cbind(t(combn(k, 2)), pairs$estimate, pairs$SE)
  list(
    data = within(data, rm(carry)), position = test(full, update(full, . ~ . - position)),
    condition = test(full, update(full, . ~ . - condition)), carry_over = test(full, update(full, . ~ . - carry)),
    condition_without_carry_over = test(simple, update(simple, . ~ . - condition)), pairs = own
  )
}
out <- list(r = R.version.string, sets = lapply(sets, analyse))
write(toJSON(out, digits = NA, auto_unbox = TRUE, dataframe = "columns", na = "null"), "order_effects.json")
