!> Backbone curves: free periodic motions of a system without losses, grown from a
!! linear mode (nonlinear normal modes).
!!
!! M u'' + F(u) = 0 keeps its form when time runs backwards, so a free motion that
!! begins at rest, u'(0) = 0, is even in time: u = sum_k a_k cos(k nu t). That settles
!! the phase, and the equations of harmonic balance in (a, nu), one fewer than
!! unknowns, have curves of solutions; one of them leaves rest at each linear mode.
!! Rosenberg, Adv. Appl. Mech. 9 (1966) 155; Kerschen et al., Mech. Syst. Signal
!! Process. 23 (2009) 170.
module viscovib_backbone
  use viscovib_branch, only: angle_between, branch_completed, branch_options, branch_overflow, &
    branch_step_limit, branch_stuck, correct, curve_point, parameter_frequency, smallest_step, &
    wanted_angle
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: backbone_type, follow_backbone

  type :: backbone_type
    integer :: n_points = 0, outcome = branch_step_limit
    !> Frequencies, shape (max_points), and harmonics, shape (2 n_orders, n_dof,
    !! max_points).
    real(wp), allocatable :: nu(:), x(:, :, :)
  end type backbone_type

contains

  !> From amplitude options%start to options%finish, in the first harmonic of a
  !! coordinate.
  subroutine follow_backbone(system, set, omega, shape_at_rest, dof, options, backbone, cancel)
    !> Without damping and memory.
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Frequency and shape (n_dof) of the linear mode.
    real(wp), intent(in) :: omega, shape_at_rest(:)
    !> The coordinate whose amplitude counts.
    integer, intent(in) :: dof
    type(branch_options), intent(in) :: options
    type(backbone_type), intent(out) :: backbone
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile :: cancel
    type(balance_type) :: balance
    type(load_type) :: no_load
    type(status_type) :: status
    type(curve_point) :: here, next
    complex(wp) :: nothing(size(shape_at_rest), 0), still(0)
    real(wp) :: step, angle
    integer :: first
    logical :: made

    call new_load(no_load, size(shape_at_rest), [integer ::], nothing, still, status)
    call new_balance(balance, system, set)
    balance%even_in_time = .true.
    allocate (backbone%nu(options%max_points), &
              backbone%x(2*size(set%orders), size(shape_at_rest), options%max_points))
    ! The cosine of order 1.
    first = 2*findloc(set%orders, 1, 1)
    allocate (here%x(2*size(set%orders), size(shape_at_rest)), source=0.0_wp)
    here%slope_x = here%x
    here%x(first, :) = options%start*shape_at_rest/shape_at_rest(dof)
    here%slope_x(first, dof) = 1.0_wp
    here%p = omega
    here%p_scale = omega
    here%slope_p = 0.0_wp
    ! Corrected at this amplitude, for the frequency and the tangent.
    call correct(balance, system, no_load, parameter_frequency, options, here, 0.0_wp, next, made)
    if (.not. made) then
      backbone%outcome = branch_stuck
      return
    end if
    if (next%slope_x(first, dof)*next%x(first, dof) < 0.0_wp) then
      next%slope_x = -next%slope_x
      next%slope_p = -next%slope_p
    end if
    here = next
    call add(backbone, here)
    step = options%max_step
    do while (backbone%n_points < options%max_points)
      if (cancel /= 0) return
      call correct(balance, system, no_load, parameter_frequency, options, here, step, next, made)
      angle = 0.0_wp
      if (made) then
        angle = angle_between(system, here, next)
        if (angle > 4.0_wp*wanted_angle .and. step > 1.0e3_wp*smallest_step) made = .false.
      end if
      if (.not. made) then
        step = 0.4_wp*step
        if (step > smallest_step) cycle
        backbone%outcome = branch_stuck
        return
      end if
      if (.not. maxval(abs(next%x)) <= system%largest_amplitude()) then
        backbone%outcome = branch_overflow
        return
      end if
      if (abs(next%x(first, dof)) >= options%finish) then
        call land()
        return
      end if
      here = next
      call add(backbone, here)
      step = step*min(2.0_wp, max(0.5_wp, wanted_angle/max(angle, 1.0e-12_wp)))
      if (here%iterations > 5) step = 0.6_wp*step
      step = min(step, options%max_step)
    end do

  contains

    !> The last point lies at the end itself: shorten the step until it does.
    subroutine land()
      real(wp) :: low, high, low_a, high_a, trial, a
      integer :: k
      low = 0.0_wp
      low_a = abs(here%x(first, dof))
      high = step
      high_a = abs(next%x(first, dof))
      do k = 1, 60
        a = abs(next%x(first, dof))
        if (abs(a - options%finish) <= 1.0e-12_wp*options%finish) exit
        trial = low + (high - low)*min(0.98_wp, max(0.02_wp, (options%finish - low_a) &
                                                    /(high_a - low_a)))
        call correct(balance, system, no_load, parameter_frequency, options, here, trial, next, &
                     made)
        if (.not. made) exit
        a = abs(next%x(first, dof))
        if (a < options%finish) then
          low = trial
          low_a = a
        else
          high = trial
          high_a = a
        end if
      end do
      backbone%outcome = merge(branch_completed, branch_stuck, made)
      if (made) call add(backbone, next)
    end subroutine land

  end subroutine follow_backbone

  subroutine add(backbone, point)
    type(backbone_type), intent(inout) :: backbone
    type(curve_point), intent(in) :: point
    backbone%n_points = backbone%n_points + 1
    backbone%nu(backbone%n_points) = point%p
    backbone%x(:, :, backbone%n_points) = point%x
  end subroutine add

end module viscovib_backbone
