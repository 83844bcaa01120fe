!> The &branch group of a scene: a branch of periodic solutions in the frequency.
module viscovib_branch_job
  use viscovib_checks, only: check_positive
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_outcomes, follow_curve
  use viscovib_files, only: make_folder
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_newton_point, only: point_from_rest
  use viscovib_number_text, only: exact
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_frequency
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_plan, only: method_newton, response_plan_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: branch_job, read_branch, plan_branch, run_branch, write_branch

  integer, parameter :: max_branch_points = 100000

  type :: branch_job
    real(wp) :: nu_from = 0.0_wp, nu_to = 0.0_wp
    type(response_options) :: options
    integer :: max_points = 2000
    real(wp) :: max_step = 0.1_wp
  end type branch_job

contains

  subroutine read_branch(reader, job)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(out) :: job
    type(status_type) :: status

    job%nu_from = reader%read_real('nu_from')
    job%nu_to = reader%read_real('nu_to')
    job%options%harmonics = reader%read_integer('harmonics', job%options%harmonics)
    job%options%tolerance = reader%read_real('tolerance', job%options%tolerance)
    job%max_points = reader%read_integer('max_points', job%max_points)
    job%max_step = reader%read_real('max_step', job%max_step)
    if (reader%status%failed()) return
    call check_positive('nu_from', job%nu_from, status)
    call reader%place(status)
    call check_positive('nu_to', job%nu_to, status)
    call reader%place(status)
    if (.not. abs(job%nu_to - job%nu_from) > 0.0_wp) then
      call reader%complain('nu_to', 'nu_to = '//show(job%nu_to)//': must differ from nu_from')
    end if
    if (job%max_points < 2 .or. job%max_points > max_branch_points) then
      call reader%complain('max_points', 'max_points = '//show(job%max_points)//': must be 2 to ' &
                           //show(max_branch_points))
    end if
    if (job%max_step < 1.0e-4_wp .or. job%max_step > 1.0_wp) then
      call reader%complain('max_step', 'max_step = '//show(job%max_step) &
                           //': must be in [1e-4, 1]')
    end if
  end subroutine read_branch

  !> What will be computed.
  function plan_branch(nu_from, nu_to, n_orders) result(text)
    real(wp), intent(in) :: nu_from, nu_to
    integer, intent(in) :: n_orders
    character(len=:), allocatable :: text
    text = 'computes: the branch from nu = '//show(nu_from)//' to '//show(nu_to)//', ' &
           //show(n_orders)//' harmonics a coordinate'//new_line('a')
  end function plan_branch

  !> Follow the branch as planned.
  subroutine run_branch(job, plan, system, load, branch, status)
    type(branch_job), intent(in) :: job
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(curve_branch_type), intent(out) :: branch
    type(status_type), intent(out) :: status
    type(oscillator_curve_type) :: curve
    real(wp) :: x(2*size(plan%set%orders), system%n_dof())
    integer :: outcome, iterations

    if (plan%method /= method_newton) then
      call fail(status, status_input_error, 'branch', 'nothing is nonlinear, the response is a ' &
                //'single curve: ask for &response')
      return
    end if
    call new_oscillator_curve(curve, system, load, plan%set, vary_frequency)
    call curve%balance%set_frequency(system, load, job%nu_from)
    iterations = 0
    call point_from_rest(curve%balance, system, load, job%options%tolerance, x, outcome, iterations)
    if (outcome /= outcome_converged) then
      call fail(status, status_input_error, 'nu_from', 'nu_from = '//show(job%nu_from) &
                //': no solution was found there, begin elsewhere')
      return
    end if
    call follow_curve(curve, curve_options(job%nu_from, job%nu_to, job%options%tolerance, &
                                           job%max_points, job%max_step), &
                      reshape(x, [size(x)]), branch)
    call add_base_motion()

  contains

    !> From coordinates relative to the base to absolute ones.
    subroutine add_base_motion()
      integer :: i, j, d, k
      do j = 1, size(load%orders)
        do i = 1, size(plan%set%orders)
          if (plan%set%orders(i) /= load%orders(j)) cycle
          do d = 1, system%n_dof()
            k = 2*(i + size(plan%set%orders)*(d - 1))
            branch%x(k - 1, :branch%n_points) = branch%x(k - 1, :branch%n_points) &
                                                + system%base_direction(d)*real(load%base(j))
            branch%x(k, :branch%n_points) = branch%x(k, :branch%n_points) &
                                            + system%base_direction(d)*aimag(load%base(j))
          end do
        end do
      end do
    end subroutine add_base_motion

  end subroutine run_branch

  !> Write the table NAME in a folder, which is made if need be; the table is there
  !! whole or not at all.
  subroutine write_branch(folder, name, orders, branch, coordinates, units, header, status)
    character(len=*), intent(in) :: folder, name
    integer, intent(in) :: orders(:)
    type(curve_branch_type), intent(in) :: branch
    !> Names and units, one a coordinate.
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(text_writer) :: table
    character(len=:), allocatable :: row, order
    integer :: i, d, k

    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    call table%add_comments(header)
    row = '# branch '//trim(curve_outcomes(branch%outcome))//'; folds at nu ='
    do i = 1, branch%folds%n
      row = row//' '//trim(exact(branch%folds%p(i)))
    end do
    call table%add_line(row)
    row = '# nu (rad/s); u = Im sum_k X_k exp(i k nu t)'
    do d = 1, size(coordinates)
      row = row//', '//trim(coordinates(d))//' in '//trim(units(d))
    end do
    call table%add_line(row)
    row = 'nu'
    do d = 1, size(coordinates)
      do k = 1, size(orders)
        order = trim(coordinates(d))//'_'//show(orders(k))
        row = row//','//order//'_re,'//order//'_im'
      end do
    end do
    call table%add_line(row)
    do i = 1, branch%n_points
      row = trim(exact(branch%parameter(i)))
      do k = 1, size(branch%x, 1)
        row = row//','//trim(exact(branch%x(k, i)))
      end do
      call table%add_line(row)
    end do
    call table%finish(status)
  end subroutine write_branch

end module viscovib_branch_job
