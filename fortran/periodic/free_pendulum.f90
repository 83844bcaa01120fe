! Optimize: -O2
!> Free motions of a pendulum without losses: start of a curve at a linear mode, and its plan.
module viscovib_free_pendulum
  use viscovib_free_family, only: free_options
  use viscovib_free_orders, only: chosen_text
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: equations_printed, new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: fail, show, status_input_error, status_type, things
  implicit none
  private

  public :: begin_free, free_text

  character(len=*), parameter, public :: pendulum_names(3) = [character(len=3) :: 'z', 'phi', 'psi']

contains

  !> Complete the options of a curve with its linear mode, and return the system without losses.
  subroutine begin_free(pendulum, by_energy, options, system, status)
    type(pendulum_type), intent(in) :: pendulum
    !> True if the energy is the parameter.
    logical, intent(in) :: by_energy
    !> With `mode`, `highest`, `order`, and `dof`, 0: the coordinate that moves most.
    type(free_options), intent(inout) :: options
    type(pendulum_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(pendulum_parameters) :: parameters
    real(wp) :: omega(3), shapes(3, 3), first(options%highest*options%order + 1, 3)

    parameters = pendulum%parameters
    parameters%damping = 0.0_wp
    parameters%load = 0.0_wp
    call new_pendulum(system, parameters, status)
    if (status%failed()) return
    if (options%mode > 0 .and. parameters%equations == equations_printed) then
      call fail(status, status_input_error, 'mode', 'mode = '//show(options%mode)//': the ' &
                //'printed equations keep no energy in swings, must be 0 with them')
      return
    end if
    call system%natural_modes(omega, shapes)
    associate (shape => shapes(:, options%mode + 1))
      if (options%dof == 0) options%dof = maxloc(abs(shape), 1)
      if (.not. abs(shape(options%dof)) > 0.0_wp) then
        call fail(status, status_input_error, 'dof', "dof = '"//trim(pendulum_names(options%dof)) &
                  //"': does not move in mode "//show(options%mode))
        return
      end if
      first = 0.0_wp
      first(options%order + 1, :) = shape/shape(options%dof)
    end associate
    options%begin = [first]
    if (by_energy) options%dof = 0
    options%unit = omega(options%mode + 1)/options%order
    options%pattern = kept_orders(parameters%equations, options)
  end subroutine begin_free

  !> Orders of z, phi, psi that are unknowns, shape (2 order, 3), which repeat: the printed
  !! equations keep energy in z only; symmetric motions are mirrored in phi and psi half a period
  !! later, and those of mode 0 do not swing.
  pure function kept_orders(equations, options) result(kept)
    integer, intent(in) :: equations
    type(free_options), intent(in) :: options
    logical :: kept(0:2*options%order - 1, 3)

    kept = .not. options%symmetric
    if (options%mode == 0 .and. (options%symmetric .or. equations == equations_printed)) then
      kept(:, 1) = .true.
      kept(:, 2:) = .false.
    else if (options%symmetric) then
      kept(0, 1) = .true.
      kept(options%order, 2:) = .true.
    end if
  end function kept_orders

  !> Lines of a plan.
  function free_text(options) result(text)
    type(free_options), intent(in) :: options
    character(len=:), allocatable :: text, kept
    character(len=*), parameter :: nl = new_line('a')

    kept = things(count(options%kept(options%highest*options%order)), 'cosine')
    if (options%chosen) kept = chosen_text(options%highest)
    text = 'computes: free motions of mode '//show(options%mode)//' from ' &
           //trim(merge('energy   ', 'amplitude', options%dof == 0))//' ' &
           //show(options%curve%start)//' to '//show(options%curve%finish)//', '//kept//nl &
           //'skips: damping and loads (free motions of the system without losses)'//nl &
           //'skips: sines (motions that start at rest are even in time)'//nl &
           //trim(merge('computes: Floquet multipliers   ', 'skips: stability (not requested)', &
                        options%stability))//nl
  end function free_text

end module viscovib_free_pendulum
