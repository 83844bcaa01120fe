! Optimize: -O1
!> Catalogue of hysteresis elements, by number.
module viscovib_hysteresis_catalogue
  use viscovib_bouc_wen_element, only: bouc_wen_element, new_bouc_wen
  use viscovib_dahl_element, only: dahl_element, new_dahl
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_jenkins_element, only: jenkins_element, new_jenkins
  use viscovib_kinds, only: wp
  use viscovib_status, only: show
  use viscovib_user_elements, only: new_user_element
  implicit none
  private

  public :: new_hysteresis, order_numbers

  !> Values of `state` of a law term. User-defined elements have numbers above `state_user`.
  integer, parameter, public :: state_jenkins = 1, state_bouc_wen = 2, state_dahl = 3, &
                                state_user = 1000

contains

  !> Create an element from its parameters, in the order of its constructor.
  subroutine new_hysteresis(element, kind, numbers)
    class(hysteresis_type), allocatable, intent(out) :: element
    integer, intent(in) :: kind
    real(wp), intent(in) :: numbers(:)
    type(jenkins_element) :: jenkins
    type(bouc_wen_element) :: bouc_wen
    type(dahl_element) :: dahl

    select case (kind)
    case (state_bouc_wen)
      call new_bouc_wen(bouc_wen, numbers)
      allocate (element, source=bouc_wen)
    case (state_dahl)
      call new_dahl(dahl, numbers)
      allocate (element, source=dahl)
    case (state_jenkins)
      call new_jenkins(jenkins, numbers)
      allocate (element, source=jenkins)
    case default
      call new_user_element(element, kind - state_user, numbers)
    end select
  end subroutine new_hysteresis

  !> Check the numbers of a scene, and put them in the order of a constructor.
  subroutine order_numbers(kind, numbers, state, fault)
    !> 'jenkins': stiffness and limit of each slider; 'dahl': stiffness, limit, exponent;
    !! 'bouc_wen': stiffness, ratio, beta, gamma, exponent.
    character(len=*), intent(in) :: kind
    real(wp), allocatable, intent(inout) :: numbers(:)
    integer, intent(out) :: state
    !> Description of an error; empty: none.
    character(len=:), allocatable, intent(out) :: fault
    character(len=*), parameter :: where = 'hysteresis_numbers: '
    integer :: i

    fault = ''
    select case (kind)
    case ('jenkins')
      state = state_jenkins
      if (size(numbers) == 0 .or. mod(size(numbers), 2) > 0) fault = ', must be stiffness limit, ' &
        //'for each slider'
    case ('dahl')
      state = state_dahl
      if (size(numbers) == 2) numbers = [numbers, 1.0_wp]
      if (size(numbers) /= 3) fault = ', must be stiffness limit [exponent]'
    case default
      state = state_bouc_wen
      if (size(numbers) == 4) numbers = [numbers, 1.0_wp]
      if (size(numbers) /= 5) fault = ', must be stiffness ratio beta gamma [exponent]'
    end select
    if (fault /= '') then
      fault = where//show(size(numbers))//' numbers'//fault
      return
    end if
    if (state == state_bouc_wen) then
      call check('ratio', 2, 0.0_wp, 1.0_wp - epsilon(1.0_wp), '0 to less than 1')
      call check('exponent', 5, 1.0_wp, 20.0_wp, '1 to 20')
    else if (state == state_dahl) then
      call check('exponent', 3, 0.0_wp, 20.0_wp, '0 to 20')
    end if
    do i = 1, merge(size(numbers), 2, state == state_jenkins)
      if (state == state_bouc_wen) then
        call check(merge('stiffness', 'beta     ', i == 1), 2*i - 1, tiny(1.0_wp), huge(1.0_wp), &
                   'greater than 0')
      else
        call check(merge('stiffness', 'limit    ', mod(i, 2) == 1), i, tiny(1.0_wp), &
                   huge(1.0_wp), 'greater than 0')
      end if
    end do
    if (fault /= '' .or. state /= state_bouc_wen) return
    numbers = [numbers(2)*numbers(1), (1.0_wp - numbers(2))*numbers(1), 1.0_wp, numbers(3:5)]

  contains

    subroutine check(name, i, least, most, allowed)
      character(len=*), intent(in) :: name, allowed
      integer, intent(in) :: i
      real(wp), intent(in) :: least, most
      if (fault == '' .and. .not. (numbers(i) >= least .and. numbers(i) <= most)) fault = where &
        //trim(name)//' = '//show(numbers(i))//': must be '//allowed
    end subroutine check

  end subroutine order_numbers

end module viscovib_hysteresis_catalogue
