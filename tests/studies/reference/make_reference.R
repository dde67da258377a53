# Reference values for one-way repeated-measures analyses: Rscript make_reference.R (writes reference.json beside it).
# Needs afex, car and nlme (Debian: r-cran-afex, r-cran-car). The data are drawn here and written with the values.
suppressPackageStartupMessages({
  library(afex)
  library(car)
  library(nlme)
})
options(warn = 1)

json <- function(x) {
  if (is.list(x) && !is.null(names(x))) {
    inner <- vapply(names(x), function(name) paste0("\"", name, "\": ", json(x[[name]])), "")
    paste0("{", paste(inner, collapse = ", "), "}")
  } else if (is.list(x)) {
    paste0("[", paste(vapply(x, json, ""), collapse = ", "), "]")
  } else if (is.matrix(x)) {
    json(lapply(seq_len(nrow(x)), function(i) x[i, ]))
  } else if (is.character(x)) {
    text <- paste0("\"", x, "\"")
    if (length(text) == 1) text else paste0("[", paste(text, collapse = ", "), "]")
  } else {
    text <- ifelse(is.finite(x), sprintf("%.17g", x), "null")
    if (length(text) == 1) text else paste0("[", paste(text, collapse = ", "), "]")
  }
}

draw <- function(seed, n, k, effect, covariance, offset = 0, scale = 1) {
  set.seed(seed)
  x <- matrix(rnorm(n * k), n) %*% chol(covariance)
  offset + scale * sweep(x, 2, effect, "+")
}
symmetric <- function(k, rho) matrix(rho, k, k) + diag(1 - rho, k)
decaying <- function(k, rho, sd = rep(1, k)) outer(sd, sd) * rho^abs(outer(1:k, 1:k, "-"))

# The first seed whose untruncated Huynh-Feldt epsilon passes 1.
above_one <- function(n, k, effect, covariance) {
  for (seed in 1:1000) {
    x <- draw(seed, n, k, effect, covariance)
    s <- var(x %*% contr.helmert(k) %*% diag(1 / sqrt(colSums(contr.helmert(k)^2))))
    gg <- sum(diag(s))^2 / ((k - 1) * sum(s^2))
    if ((n * (k - 1) * gg - 2) / ((k - 1) * (n - 1 - (k - 1) * gg)) > 1.02) return(x)
  }
  stop("no seed")
}

with_gaps <- function(x, cells) {
  x[cells] <- NA
  x
}

studies <- list(
  two_conditions = draw(11, 20, 2, c(0, 0.6), symmetric(2, 0.5)),
  two_conditions_three_subjects = draw(12, 3, 2, c(0, 1), symmetric(2, 0.5)),
  three_conditions_sphericity_met = draw(13, 12, 3, c(0, 0.3, 0.9), symmetric(3, 0.6)),
  four_conditions_sphericity_violated = draw(14, 24, 4, c(0, 0.5, 1, 1.2), decaying(4, 0.8, c(1, 1.5, 2.5, 4))),
  five_conditions_of_a_study = draw(15, 36, 5, c(0.49, 0.55, 0.55, 0.59, 0.58), symmetric(5, 0.6) * 0.01),
  ten_conditions = draw(16, 30, 10, seq(0, 0.9, 0.1), decaying(10, 0.7)),
  ten_conditions_ten_subjects = draw(17, 10, 10, seq(0, 1.8, 0.2), symmetric(10, 0.4)),
  huynh_feldt_above_one = above_one(15, 4, c(0, 0.2, 0.4, 0.8), symmetric(4, 0.5)),
  missing_cells = with_gaps(
    draw(18, 20, 4, c(0, 0.4, 0.8, 0.9), decaying(4, 0.7, c(1, 1, 2, 2))), cbind(c(3, 9, 9, 17), c(2, 1, 4, 3))
  ),
  as_many_subjects_as_conditions = draw(19, 4, 4, c(0, 1, 2, 3), symmetric(4, 0.3)),
  fewer_subjects_than_conditions = draw(20, 4, 5, c(0, 1, 2, 3, 4), symmetric(5, 0.3)),
  large_offset = draw(21, 16, 4, c(0, 0.3, 0.6, 0.9), decaying(4, 0.6), offset = 1e6),
  small_unit = draw(22, 16, 3, c(0, 0.3, 0.6), symmetric(3, 0.6), offset = 2, scale = 1e-6),
  ties_on_a_scale = {
    x <- draw(23, 18, 3, c(0, 0.5, 1.2), symmetric(3, 0.5))
    matrix(pmin(7, pmax(1, round(4 + 1.3 * x))), 18)
  },
  no_effect = draw(24, 25, 3, c(0, 0, 0), symmetric(3, 0.4)),
  no_spread_of_subjects = draw(25, 12, 4, c(0, 0.3, 0.6, 0.9), symmetric(4, -0.25)),
  very_large_effect = draw(26, 40, 3, c(0, 10, 30), symmetric(3, 0.9))
)

# Greenhouse-Geisser epsilon, where car gives none.
epsilon_of <- function(x) {
  k <- ncol(x)
  contrasts <- contr.helmert(k) %*% diag(1 / sqrt(colSums(contr.helmert(k)^2)), k - 1)
  s <- var(x %*% contrasts)
  sum(diag(s))^2 / ((k - 1) * sum(s^2))
}

limit <- function(f, df1, df2, probability) {
  if (pf(f, df1, df2) <= probability) return(0)
  upper <- 1
  while (pf(f, df1, df2, upper) > probability) upper <- 2 * upper
  uniroot(function(l) pf(f, df1, df2, l) - probability, c(0, upper), tol = 1e-13 * upper)$root
}

analyse <- function(given) {
  k <- ncol(given)
  x <- given[stats::complete.cases(given), , drop = FALSE]
  n <- nrow(x)
  long <- data.frame(
    subject = factor(rep(seq_len(n), k)), condition = factor(rep(seq_len(k), each = n)), value = as.vector(x)
  )
  fit <- suppressMessages(suppressWarnings(aov_ez("subject", "value", long, within = "condition")))
  row <- suppressWarnings(anova(fit, es = c("ges", "pes"), correction = "none"))
  f <- row[["F"]]
  df1 <- row[["num Df"]]
  df2 <- row[["den Df"]]
  univariate <- suppressWarnings(summary(fit$Anova, multivariate = FALSE))
  tests <- univariate$sphericity.tests
  adjusted <- univariate$pval.adjustments
  has <- !is.null(tests) && nrow(tests) > 0
  w <- if (has) tests["condition", "Test statistic"] else NA
  mauchly_p <- if (has) tests["condition", "p-value"] else NA
  if (k > 2 && n > k - 1) { # car gives nothing when the unit is small; mauchly.test does
    other <- mauchly.test(lm(x ~ 1), X = ~1)
    if (has) stopifnot(abs(other$p.value - mauchly_p) < 1e-9, abs(other$statistic - w) < 1e-9)
    w <- unname(other$statistic)
    mauchly_p <- other$p.value
  }
  # As the test: degrees of freedom times epsilon; n (k - 1) of them in all, which turns lambda into eta squared.
  epsilon <- if (has) adjusted["condition", "GG eps"] else epsilon_of(x)
  tail <- limit(f, epsilon * df1, epsilon * df2, 0.95)
  head <- limit(f, epsilon * df1, epsilon * df2, 0.05)
  total <- epsilon * (df1 + df2)
  pairs <- combn(k, 2)
  compared <- apply(pairs, 2, function(ij) {
    found <- t.test(x[, ij[1]], x[, ij[2]], paired = TRUE)
    d <- x[, ij[1]] - x[, ij[2]]
    normal <- shapiro.test(d)
    c(ij, found$estimate, found$conf.int, found$statistic, found$parameter, found$p.value, mean(d) / sd(d),
      mean(d) / ((sd(x[, ij[1]]) + sd(x[, ij[2]])) / 2), normal$statistic, normal$p.value)
  })
  ranks <- friedman.test(x)
  cells <- data.frame(
    subject = factor(rep(seq_len(nrow(given)), k)), condition = factor(rep(seq_len(k), each = nrow(given))),
    value = as.vector(given)
  )
  cells <- droplevels(cells[!is.na(cells$value), ])
  cells$value <- (cells$value - mean(cells$value)) / sd(cells$value)
  mixed <- tryCatch(
    {
      control <- lmeControl(tolerance = 1e-14, msTol = 1e-14, msMaxIter = 500, maxIter = 500, opt = "nlminb")
      anova(lme(value ~ condition, random = ~ 1 | subject, data = cells, method = "REML", control = control))
    },
    error = function(e) NULL
  )
  singular <- suppressMessages(isSingular(lme4::lmer(value ~ condition + (1 | subject), cells), tol = 1e-6))
  list(
    data = given, complete = as.numeric(n),
    mean = colMeans(x), sd = apply(x, 2, sd),
    ci = t(apply(x, 2, function(v) t.test(v)$conf.int)),
    F = f, df1 = df1, df2 = df2, p = row[["Pr(>F)"]],
    eta2_generalized = row[["ges"]], eta2_partial = row[["pes"]],
    eta2_partial_low = tail / (tail + total), eta2_partial_high = head / (head + total),
    mauchly_w = w, mauchly_p = mauchly_p,
    epsilon_gg = if (has) adjusted["condition", "GG eps"] else NA,
    epsilon_hf_untruncated = if (has) adjusted["condition", "HF eps"] else NA,
    p_gg = if (has) adjusted["condition", "Pr(>F[GG])"] else NA,
    p_hf = if (has) adjusted["condition", "Pr(>F[HF])"] else NA,
    pairs = list(
      a = compared[1, ], b = compared[2, ], mean_difference = compared[3, ], ci_low = compared[4, ],
      ci_high = compared[5, ], t = compared[6, ], df = compared[7, ], p = compared[8, ],
      p_bonferroni = p.adjust(compared[8, ], "bonferroni"), p_holm = p.adjust(compared[8, ], "holm"),
      d_z = compared[9, ], d_av = compared[10, ], shapiro_w = compared[11, ], shapiro_p = compared[12, ]
    ),
    friedman_chi2 = unname(ranks$statistic), friedman_df = unname(ranks$parameter), friedman_p = ranks$p.value,
    mixed_F = if (is.null(mixed) || singular) NA else mixed["condition", "F-value"],
    mixed_df2 = if (is.null(mixed) || singular) NA else mixed["condition", "denDF"]
  )
}

folder <- dirname(sub("--file=", "", grep("--file=", commandArgs(), value = TRUE)))
found <- lapply(studies, analyse)
made <- c(
  R = paste(R.version$major, R.version$minor, sep = "."), afex = as.character(packageVersion("afex")),
  car = as.character(packageVersion("car")), nlme = as.character(packageVersion("nlme"))
)
lines <- vapply(names(found), function(name) paste0("\"", name, "\": ", json(found[[name]])), "")
writeLines(
  c(paste0("{\"made_with\": ", json(as.list(made)), ","), "\"studies\": {", paste(lines, collapse = ",\n"), "}}"),
  file.path(folder, "reference.json")
)
