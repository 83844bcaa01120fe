!> How far solutions of harmonic balance on a torus are off those that its equations have: what is
!! left to correct, and rounding errors (as `viscovib_rounding_error` does for oscillators). Of
!! many unknowns both are by the derivatives of `viscovib_torus_levels`, which are nearly those of
!! all.
module viscovib_torus_error
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_dense, only: largest_in_rows, solve
  use viscovib_kinds, only: wp
  use viscovib_torus_balance, only: torus_balance_type
  use viscovib_torus_levels, only: new_levels, torus_levels
  implicit none
  private

  public :: torus_error

  !> Rounding of an equation in units of its largest term, and how many signs are tried.
  real(wp), parameter :: usual = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3
  !> Unknowns up to which a matrix of all of them takes little.
  integer, parameter :: most_dense = 400

contains

  !> Against the largest unknown, as truncation is.
  subroutine torus_error(balance, p, x, most, error)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    !> Unknowns of the inner balance with which it was solved.
    integer, intent(in) :: most
    !> NaN where the derivatives are singular.
    real(wp), intent(out) :: error
    type(torus_levels) :: levels
    real(wp) :: r(balance%n, 0:all_signs), norm
    logical :: made

    error = 0.0_wp
    norm = maxval(abs(x))
    if (.not. norm > 0.0_wp) return
    error = ieee_value(error, ieee_quiet_nan)
    if (balance%n > most_dense) call new_levels(levels, balance, most)
    if (levels%ready) then
      call moved_on_levels(levels, balance, p, x, r, made)
    else
      call moved_by_all(balance, p, x, r, made)
    end if
    if (made) error = min(1.0_wp, (maxval(abs(r(:, 0))) + maxval(abs(r(:, 1:))))/norm)
  end subroutine torus_error

  !> How far the residual and its rounding, of various signs, move x: by the matrix of all unknowns.
  subroutine moved_by_all(balance, p, x, moved, made)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    !> Shape (n, 0:all_signs).
    real(wp), intent(out) :: moved(:, 0:)
    logical, intent(out) :: made
    real(wp) :: matrix(balance%n, balance%n), slope(balance%n), terms(balance%n)
    integer :: pivots(balance%n), i
    logical :: singular

    moved = 0.0_wp
    call balance%equations(x, p, moved(:, 0), matrix, slope, made)
    if (.not. made) return
    terms = terms_of(matrix, slope, x, p)
    call balance%raise_terms(x, p, terms)
    call factorize_blocks(balance%n, matrix, pivots, singular)
    made = .not. singular
    if (.not. made) return
    call add_rounding(terms, moved)
    do i = 0, all_signs
      call solve(balance%n, matrix, pivots, moved(:, i))
    end do
  end subroutine moved_by_all

  !> The same by the derivatives of two levels.
  subroutine moved_on_levels(levels, balance, p, x, moved, made)
    type(torus_levels), intent(inout) :: levels
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    real(wp), intent(out) :: moved(:, 0:)
    logical, intent(out) :: made
    real(wp), dimension(levels%inner%n) :: inner, r, slope
    real(wp) :: matrix(levels%inner%n, levels%inner%n), terms(balance%n)
    integer :: i

    moved = 0.0_wp
    call levels%match(balance)
    inner = levels%within(balance, x)
    call levels%inner%equations(inner, p, r, matrix, slope, made)
    if (.not. made) return
    ! Raised, terms of a coordinate are as large as the largest of its orders, inner or not.
    terms = levels%beyond(balance, terms_of(matrix, slope, inner, p))
    call levels%prepare(balance, p, x, made)
    if (.not. made) return
    call balance%raise_terms(x, p, terms)
    call balance%residual(x, p, moved(:, 0), made)
    if (.not. made) return
    call add_rounding(terms, moved)
    do i = 0, all_signs
      call levels%correction(balance, moved(:, i))
    end do
  end subroutine moved_on_levels

  !> The largest term of each equation.
  pure function terms_of(matrix, slope, x, p) result(terms)
    real(wp), intent(in) :: matrix(:, :), slope(:), x(:), p
    real(wp) :: terms(size(x))
    call largest_in_rows(size(x), size(x), matrix, abs(x), terms)
    terms = max(terms, abs(slope*p))
  end function terms_of

  !> Rounding of equations, of various signs, into the columns from 1 on.
  pure subroutine add_rounding(terms, r)
    real(wp), intent(in) :: terms(:)
    real(wp), intent(inout) :: r(:, 0:)
    integer :: i, k
    do i = 1, ubound(r, 2)
      do k = 1, size(terms)
        r(k, i) = sign(usual*terms(k), cos(real(i*(k + i)**2, wp)))
      end do
    end do
  end subroutine add_rounding

end module viscovib_torus_error
