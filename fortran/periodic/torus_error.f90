!> Errors of solutions of harmonic balance on a torus: the remaining correction, and rounding errors
!! (like `viscovib_rounding_error` for oscillators). With many unknowns both use the approximate
!! derivatives of `viscovib_torus_levels`.
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

  !> Rounding error of an equation relative to its largest term, and number of sign patterns.
  real(wp), parameter :: usual = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3
  !> Largest number of unknowns for which a full matrix is cheap.
  integer, parameter :: most_dense = 400

contains

  !> Error relative to the largest unknown, as for the truncation error.
  subroutine torus_error(balance, p, x, most, error)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    !> Number of unknowns of the inner balance of the solution.
    integer, intent(in) :: most
    !> NaN if the derivatives are singular.
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

  !> Displacements of x by the residual and by its rounding error, with the full matrix.
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

  !> The same with the derivatives of two levels.
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
    ! `raise_terms` raises all orders of a coordinate to its largest term, inner or not.
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

  !> Store rounding errors of the equations with several sign patterns in the columns from 1 on.
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
