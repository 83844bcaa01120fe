!> Columns of periodic motions in tables in addition to harmonics: error of the solution, sampling
!! error, and energy lost in a period.
!!
!! With the harmonics F_k of all forces and X_k of the motion relative to the base, the energy is E
!! = pi sum_k k Im(F_k conj(X_k)). It is lost in dampers, rate laws, sliders and memory; springs and
!! masses return the energy that they store. For a structure, with its condensed coordinates, it is
!! the energy supplied by the loads: the formula with their harmonics P_k in place of F_k.
module viscovib_motion_checks
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_rounding_error, only: rounding_checker
  use viscovib_sampling_error, only: sampling_checker
  implicit none
  private

  public :: errors_of, sampling_of, losses_of, work_of, relative_motions

contains

  !> Subtract the motion of the base.
  subroutine relative_motions(system, load, orders, factor, motions)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    !> Load factor of each motion.
    real(wp), intent(in) :: factor(:)
    !> Shape (n_orders, n_dof, n).
    complex(wp), intent(inout) :: motions(:, :, :)
    complex(wp) :: y(size(motions, 2))
    integer :: d, j, k

    if (.not. load%moves_base()) return
    do j = 1, size(load%orders)
      k = findloc(orders, load%orders(j), 1)
      if (k == 0) cycle
      y = load%shift(system, j)
      do d = 1, size(y)
        motions(k, d, :) = motions(k, d, :) - factor*y(d)
      end do
    end do
  end subroutine relative_motions

  !> Relative errors of motions as solutions of their equations; NaN if unknown.
  subroutine errors_of(system, load, orders, nu, found, highest, linear, motions, errors)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    !> Frequency (rad/s), whether it was found, and highest order, of each motion.
    real(wp), intent(in) :: nu(:)
    logical, intent(in) :: found(:)
    integer, intent(in) :: highest(:)
    !> True if the motions are those of the forces linearized at zero.
    logical, intent(in) :: linear
    !> Relative to the base, shape (n_orders, n_dof, n).
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: errors(:)
    type(rounding_checker) :: checker
    complex(wp), allocatable :: whole(:, :)
    integer, allocatable :: kept(:)
    integer :: i, k

    errors = ieee_value(errors, ieee_quiet_nan)
    ! Linear motions contain the load's orders only.
    if (linear .and. size(orders) > 0 .and. all(mod(orders, 2) == 1)) then
      allocate (kept, source=[(k, k=1, maxval(orders), 2)])
    else if (linear) then
      allocate (kept, source=[(k, k=0, max(0, maxval(orders)))])
    else
      allocate (kept, source=orders)
    end if
    do i = 1, size(nu)
      if (.not. (found(i) .and. is_finite(motions(:, :, i)))) cycle
      allocate (whole(count(kept <= highest(i)), size(motions, 2)), source=(0.0_wp, 0.0_wp))
      do k = 1, count(orders <= highest(i))
        whole(findloc(kept, orders(k), 1), :) = motions(k, :, i)
      end do
      call checker%error_of(system, load, nu(i), kept(1) > 0, linear, unknowns(whole), errors(i))
      if (errors(i) < 0.0_wp) errors(i) = ieee_value(errors(i), ieee_quiet_nan)
      deallocate (whole)
    end do
  end subroutine errors_of

  !> Relative errors by the sampling of forces; NaN if unknown.
  subroutine sampling_of(system, load, orders, nu, factor, highest, motions, errors)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    !> Frequency (rad/s), load factor, and highest order, of each motion.
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: highest(:)
    !> Relative to the base, shape (n_orders, n_dof, n).
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: errors(:)
    type(sampling_checker) :: checker
    real(wp), allocatable :: x(:, :)
    integer :: i

    errors = ieee_value(errors, ieee_quiet_nan)
    do i = 1, size(nu)
      if (.not. is_known(motions(:, :, i), highest(i))) cycle
      x = unknowns(motions(:count(orders <= highest(i)), :, i))
      call checker%error_of(system, load, nu(i), factor(i), orders(1) > 0, x, errors(i))
      if (errors(i) < 0.0_wp) errors(i) = ieee_value(errors(i), ieee_quiet_nan)
    end do
  end subroutine sampling_of

  !> Energy that all forces of a system absorb in a period (J); NaN if no motion was found.
  subroutine losses_of(system, load, orders, nu, factor, highest, linear, motions, lost)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: highest(:)
    !> True if the motions are those of the forces linearized at zero.
    logical, intent(in) :: linear
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: lost(:)
    type(balance_type) :: balance
    type(harmonic_set_type) :: set
    integer :: i, m, made

    lost = ieee_value(lost, ieee_quiet_nan)
    made = 0
    do i = 1, size(nu)
      m = count(orders <= highest(i))
      if (linear) m = size(orders)
      if (.not. is_known(motions(:, :, i), m)) cycle
      if (linear) then
        lost(i) = of_linear(system, orders, nu(i), motions(:, :, i))
        cycle
      end if
      if (m /= made) then
        call new_harmonic_set(set, orders(m), orders(1) > 0, system%degree)
        call new_balance(balance, system, set)
        made = m
      end if
      call balance%set_frequency(system, load, nu(i))
      ! Forces only; not for `moving` systems, whose forces depend on the load.
      balance%load_factor = 0.0_wp*factor(i)
      lost(i) = of_forces(balance, system, orders(:m), motions(:m, :, i))
    end do
  end subroutine losses_of

  !> Work of forces in a period, pi sum_k k Im(P_k conj(X_k)).
  pure real(wp) function work_of(orders, force, x) result(work)
    integer, intent(in) :: orders(:)
    !> Shape (n_orders, n).
    complex(wp), intent(in) :: force(:, :), x(:, :)
    integer :: d

    work = 0.0_wp
    do d = 1, size(x, 2)
      work = work + pi*sum(orders*aimag(force(:, d)*conjg(x(:, d))))
    end do
  end function work_of

  real(wp) function of_forces(balance, system, orders, x) result(lost)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: orders(:)
    complex(wp), intent(in) :: x(:, :)
    real(wp) :: r(2*size(x, 1), size(x, 2))

    call balance%residual(system, unknowns(x), r)
    lost = work_of(orders, cmplx(r(1::2, :), r(2::2, :), wp), x)
  end function of_forces

  real(wp) function of_linear(system, orders, nu, x) result(lost)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu
    complex(wp), intent(in) :: x(:, :)
    complex(wp) :: fraction(size(orders), system%n_memory()), force(size(x, 1), size(x, 2))
    complex(wp) :: stiffness(size(x, 2), size(x, 2), size(orders))
    integer :: k

    call system%retained(orders*nu, fraction)
    call system%dynamic_stiffness(orders*nu, spread(nu, 1, size(orders)), fraction, stiffness)
    do k = 1, size(orders)
      force(k, :) = matmul(stiffness(:, :, k), x(k, :))
    end do
    lost = work_of(orders, force, x)
  end function of_linear

  !> Alternating real and imaginary parts.
  pure function unknowns(motion) result(x)
    complex(wp), intent(in) :: motion(:, :)
    real(wp) :: x(2*size(motion, 1), size(motion, 2))
    x(1::2, :) = real(motion)
    x(2::2, :) = aimag(motion)
  end function unknowns

  pure logical function is_known(motion, highest)
    complex(wp), intent(in) :: motion(:, :)
    integer, intent(in) :: highest
    is_known = highest > 0 .and. is_finite(motion)
  end function is_known

  pure logical function is_finite(motion)
    complex(wp), intent(in) :: motion(:, :)
    is_finite = all(ieee_is_finite(real(motion))) .and. all(ieee_is_finite(aimag(motion)))
  end function is_finite

end module viscovib_motion_checks
